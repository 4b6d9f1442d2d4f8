"""The documentation: complete, true as far as a machine can tell, and its code runs.

Blocks marked ``python`` and ``sh`` are run, in the order of their page and in one folder a page, against a service;
those marked ``py``, ``shell``, ``text`` and ``json`` are not, nor are commands that install something. Where a ``text``
block follows a ``python`` block and "It prints:", it is what the block prints. A picture of a tutorial is the file of
the same name that its code writes.
"""

from __future__ import annotations

import argparse
import inspect
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import redirect_stdout, suppress
from functools import cache
from itertools import zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from types import ModuleType
from typing import Any

import pytest

import equimesh
from equimesh import (
    Acceleration,
    ArcLength,
    Boundary,
    Expression,
    Grid,
    Initial,
    LineData,
    LocalSolver,
    Ordering,
    Problem,
    Schwarz,
    Status,
    solve,
)
from equimesh.domains import curve
from equimesh.fields import samples
from equimesh.fields.expression import FUNCTIONS, LIMITS
from equimesh.io import abaqus, spectral
from equimesh.io.write import CELLS, FORMATS
from equimesh.meshes import rows
from equimesh.monitors import monitor
from equimesh.quality.measures import PER_CELL
from equimesh.sweeps import one_strip
from equimesh.transfers import mesh_values
from equimesh.upload.samples import READERS
from equimesh_cli.command import build_parser, main
from equimesh_cli.parser import Exit
from equimesh_client import Client
from equimesh_client.spec.request import DEFAULTS, MeshOptions
from equimesh_cluster.part_files.formats import PARTED_FORMATS
from equimesh_schema import schwarz as schwarz_schema
from equimesh_schema import sequences
from equimesh_schema.document import keys_of
from equimesh_schema.mesh import MeshSpec
from equimesh_service import Settings, running
from equimesh_service.api.app import create_app
from equimesh_service.problems.problem import KINDS
from equimesh_service.settings import groups
from equimesh_service.spec import document
from generator.command_pages import COMMANDS, SETTINGS, command_pages
from generator.notebooks import markdown_of, with_output

ROOT = Path(__file__).parents[2]
PAGES = {
    path.relative_to(ROOT).as_posix(): path for path in [*ROOT.glob("*.md"), *sorted((ROOT / "docs").rglob("*.md"))]
}
URL = "http://127.0.0.1:8000"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LANGUAGES = {"python", "sh", "py", "shell", "text", "json"}
PRINTS = re.compile(r"^```python\n(.*?)^```\n\nIt prints:\n\n```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
NEAR = 0.1
"""Descents amplify rounding: what they print differs by some percent from processor to processor."""


@cache
def openapi() -> dict[str, Any]:
    """The OpenAPI document, which takes a second."""
    with TemporaryDirectory() as folder:
        return create_app(Settings(data_dir=Path(folder))).openapi()


def page(name: str) -> str:
    """The text of the page of this name, in whichever folder of the docs it is."""
    (found,) = (path for path in PAGES.values() if path.stem == name)
    return found.read_text()


def blocks(text: str) -> list[tuple[str, str]]:
    """The language and the code of every block."""
    return FENCE.findall(text)


def _needs(text: str) -> list[pytest.MarkDecorator]:
    """What a page needs to be run: curl, where a command of it calls that."""
    return [pytest.mark.needs("curl")] if any(kind == "sh" and "curl" in code for kind, code in blocks(text)) else []


# Notebooks are pages, too: their cells, and what is stored of what they print.
NOTEBOOKS = {path.name: path for path in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))}


def text_of(name: str) -> str:
    """The Markdown of a page or of a notebook."""
    return PAGES[name].read_text() if name in PAGES else markdown_of(NOTEBOOKS[name])


RUN = [
    pytest.param(name, marks=_needs(text))
    for name, text in ((name, text_of(name)) for name in [*PAGES, *NOTEBOOKS])
    if any(kind in ("python", "sh") for kind, _ in blocks(text))
]


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service for all pages."""
    with running(Settings(port=0, workers=2, data_dir=tmp_path_factory.mktemp("data"), log_level="warning")) as address:
        yield address


@pytest.fixture
def page_folder(url: str, tmp_path: Path) -> Iterator[Path]:
    """The folder of a page, in which this process is; its variables are those of a reader, its figures are closed."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        for variable, value in {"EQUIMESH_URL": url, "MPLBACKEND": "agg", "PATH": path}.items():
            patch.setenv(variable, value)
        yield tmp_path
        if pyplot := sys.modules.get("matplotlib.pyplot"):
            pyplot.close("all")


def run_python(code: str, program: ModuleType) -> str:
    """What a block prints, run here as a part of a program, where warnings are errors."""
    said = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(said):
        patch.setattr(sys, "argv", ["page"])
        patch.setitem(sys.modules, "__main__", program)
        exec(compile(code, "page", "exec"), vars(program))
    return said.getvalue()


def run_shell(code: str) -> None:
    """Run a block by bash, but its commands of ``equimesh`` here, where the packages are loaded."""
    code = code.replace("curl -s ", "curl -sS --fail-with-body ")
    for command in shell_commands(code) if re.search("^equimesh ", code, re.MULTILINE) else [code]:
        words = shlex.split(command)
        if words[0] != "equimesh" or {"|", "&&", ";"} & {*words}:
            done = subprocess.run(
                ["bash", "-euo", "pipefail", "-c", command], capture_output=True, text=True, timeout=600
            )
            assert done.returncode == 0, done.stdout + done.stderr
            continue
        end = words.index(">") if ">" in words else len(words)
        with redirect_stdout(io.StringIO()) as said:
            assert main(words[1:end]) == 0, command
        for name in words[end + 1 :]:
            Path(name).write_text(said.getvalue())


def shell_commands(code: str) -> Iterator[str]:
    """The commands of a block: a line each, or more where a quotation or a backslash goes on."""
    command = ""
    for line in code.replace("\\\n", " ").splitlines(keepends=True):
        command += line
        with suppress(ValueError):  # a quotation that is not closed
            if shlex.split(command):
                yield command
            command = ""
    assert not command.strip(), f"a quotation does not end: {command}"


@pytest.mark.parametrize("name", RUN)
def test_the_code_of_a_page_runs(name: str, url: str, page_folder: Path) -> None:
    text = text_of(name).replace(URL, url)
    told, program = dict(PRINTS.findall(text)), ModuleType("__main__")
    for kind, code in blocks(text):
        if kind == "sh" and "pip install" not in code:
            run_shell(code)
            program = ModuleType("__main__")  # what follows is a program of its own
        elif kind == "python":
            printed = run_python(code, program)
            if code in told:
                assert differences(told[code], printed) == [], printed
    for kept in re.findall(r"\]\(\.\./images/tutorials/([\w-]+\.png)\)", text):
        shown, drawn = (_coarse(path) for path in (ROOT / "docs" / "images" / "tutorials" / kept, page_folder / kept))
        assert sum(abs(a - b) for a, b in zip(shown, drawn, strict=True)) / len(shown) < 5, f"store {kept} again"


def test_the_output_of_a_notebook_is_what_its_cells_show() -> None:
    code = "class Shown:\n    def _repr_html_(self):\n        return '<b>shown</b>'\nprint('said', 1)\nShown()"
    cells = [{"cell_type": "markdown", "source": ["# Title"]}, {"cell_type": "code", "source": [code], "outputs": []}]
    _, cell = with_output({"cells": cells}, "a notebook")["cells"]
    printed, shown = cell["outputs"]
    assert printed["text"] == ["said 1\n"]
    assert shown["data"]["text/html"] == ["<b>shown</b>"]
    silent = with_output({"cells": [{**cell, "source": [f"{code};"]}]}, "a notebook")["cells"][0]["outputs"]
    assert silent == [printed]


def test_notebooks_are_listed_and_show_their_output() -> None:
    readme = ROOT / "examples" / "README.md"
    assert len(NOTEBOOKS) >= 6
    for name in NOTEBOOKS:
        assert f"(notebooks/{name})" in readme.read_text(), name
        page = markdown_of(NOTEBOOKS[name])
        assert "data:image/png;base64," in page, name
        assert len(page) < 400_000, name
        links = re.findall(r"\]\((\.\.[^)#]*)", page)
        assert all((NOTEBOOKS[name].parent / link).exists() for link in links), links


def differences(told: str, printed: str) -> list[str]:
    """The lines of a text that differ from what was printed, by more than the last digit or some percent."""
    pairs = zip_longest(told.strip().splitlines(), printed.strip().splitlines(), fillvalue="")
    return [line for line, found in pairs if not _same(line, found)]


def _same(told: str, printed: str) -> bool:
    if NUMBER.sub("#", told) != NUMBER.sub("#", printed):
        return False
    for one, other in zip(NUMBER.findall(told), NUMBER.findall(printed), strict=True):
        mantissa, _, exponent = one.partition("e")
        last_digit = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
        if abs(float(one) - float(other)) > max(NEAR * abs(float(one)), 1.01 * last_digit):
            return False
    return True


def _coarse(path: Path) -> bytes:
    """The colours of a picture in 48 x 32 parts."""
    image = pytest.importorskip("PIL.Image").open(path).convert("RGB")
    return bytes(image.resize((48, 32), 4).tobytes())


def test_a_text_that_differs_from_what_is_printed_is_noticed() -> None:
    told = "error 0.0212, 12 times, status: completed\n"
    assert differences(told, "error 0.0213, 13 times, status: completed") == []
    for other in ("error 0.0312, 12 times, status: completed", "error 0.0212, 12 times, status: relaxed", ""):
        assert differences(told, other) == [told.strip()]
    assert differences(told, f"{told}more\n") == [""]


def test_every_block_says_its_language() -> None:
    for name, path in PAGES.items():
        text = path.read_text()
        fences = [line for line in text.splitlines() if line.lstrip().startswith("```")]
        assert len(fences) == 2 * len(blocks(text)), name
        assert {kind for kind, _ in blocks(text)} <= LANGUAGES, name


def anchors(text: str) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", FENCE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_links_lead_somewhere() -> None:
    found = {path: anchors(path.read_text()) for path in PAGES.values()}
    for name, path in PAGES.items():
        text = re.sub(r"`[^`\n]*`", "", FENCE.sub("", path.read_text()))
        for target in re.findall(r"\]\(([^)\s]+)\)", text):
            if re.match(r"[a-z]+:", target):
                continue
            file, _, anchor = target.partition("#")
            led = (path.parent / file).resolve() if file else path
            assert led.exists(), (name, target)
            if anchor:
                assert anchor in (found[led] if led in found else anchors(led.read_text())), (name, target)


def test_every_page_is_reached_from_the_index() -> None:
    index = PAGES["docs/index.md"].read_text()
    for name in PAGES:
        if name.startswith("docs/") and name != "docs/index.md":
            assert f"({name.removeprefix('docs/')})" in index, name


def test_the_index_of_each_kind_has_one_line_for_each_of_its_pages() -> None:
    for kind in ("tutorials", "how-to", "reference", "background", "design"):
        lines = re.findall(r"^- \[[^\]]+\]\((\S+?)\): \S.*", PAGES[f"docs/{kind}/index.md"].read_text(), re.MULTILINE)
        here = {Path(name).name for name in PAGES if name.startswith(f"docs/{kind}/")} - {"index.md"}
        assert sorted(lines) == sorted(here), kind


def row_names(text: str) -> list[str]:
    """What the first cells of all tables hold in backticks."""
    return [
        word for line in re.findall(r"^\| ([^|]*) \|", text, re.MULTILINE) for word in re.findall("`([^`]+)`", line)
    ]


def test_every_flag_has_a_meaning_and_those_of_the_page_exist() -> None:
    pages = command_pages()
    rows = re.findall(r"^\| `([^|]*)` \| (.*) \|$", pages[COMMANDS], re.MULTILINE)
    assert [option for option, meaning in rows if not meaning.strip()] == []
    known = {flag for text in pages.values() for flag in re.findall(r"`(--?[a-z][a-z0-9-]*)`", text)}
    told = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", page("cli")))
    assert told - {"--help", "--version"} <= known
    assert {"--subdomains", "--threads", "--deadline", "--max-points"} <= known


def test_every_command_and_exit_code_is_documented() -> None:
    text = page("cli")
    subparsers = next(action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction))
    assert {name for name in row_names(text) if name.startswith("equimesh ")} == {
        f"equimesh {name}" for name in subparsers.choices
    }
    codes = re.findall(r"^\| (\d+) \|", text, re.MULTILINE)
    assert [int(code) for code in codes] == [int(code) for code in Exit]


def test_every_setting_has_a_row_with_its_default_and_a_meaning() -> None:
    text = command_pages()[SETTINGS]
    rows = re.findall(r"^\| `(EQUIMESH_\w+)` \| `(--[\w-]+)` \| (.+?) \| (\S.*) \|$", text, re.MULTILINE)
    assert [row[0] for row in rows] == [f"EQUIMESH_{name.upper()}" for name in Settings.model_fields]
    assert {row[0]: row[2] for row in rows}["EQUIMESH_PORT"] == "`8000`"
    assert [name for name in groups() if not re.search(rf"^\| {name} \| \S", page("settings"), re.MULTILINE)] == []


def test_every_setting_that_any_page_names_exists() -> None:
    known = {f"EQUIMESH_{name.upper()}" for name in Settings.model_fields}
    known |= {"EQUIMESH_URL", "EQUIMESH_KEY", "EQUIMESH_QUIET", "EQUIMESH_CACHE_DIR", "EQUIMESH_"}
    for name, path in PAGES.items():
        assert set(re.findall(r"EQUIMESH_\w*", path.read_text())) <= known, name


def test_every_endpoint_is_documented_and_exists() -> None:
    paths = openapi()["paths"]
    real = {(method.upper(), path) for path, methods in paths.items() for method in methods}
    told = set()
    for row in re.findall(r"^\| `((?:[A-Z]+(?:, )?)+) (/[^`]*)`", page("http"), re.MULTILINE):
        told |= {(method, row[1]) for method in row[0].split(", ")}
    people = ("/docs", "/", "/site/{path}", "/workbench/{path}")
    pages_for_people = {(method, path) for method in ("GET", "HEAD") for path in people}
    assert told - pages_for_people == real


def test_every_query_parameter_and_header_is_described() -> None:
    paths = openapi()["paths"]
    parameters = [
        parameter
        for methods in paths.values()
        for operation in methods.values()
        for parameter in operation.get("parameters", [])
        if parameter["in"] != "path"
    ]
    assert {parameter["in"] for parameter in parameters} == {"query", "header"}
    assert [parameter["name"] for parameter in parameters if not parameter.get("description")] == []


def test_every_problem_is_documented_with_its_status() -> None:
    text = page("http").split("\n## Problems\n")[1]
    told = {
        name: int(status)
        for status, names in re.findall(r"^\| (\d{3}) \| (.+) \|$", text, re.MULTILINE)
        for name in re.findall(r"`([\w-]+)`", names)
    }
    assert told.items() <= {(name, kind.status) for name, kind in KINDS.items()}
    for name in KINDS.keys() - told.keys():  # of a failed mesh, in a sentence
        assert KINDS[name].status == 409
        assert f"`{name}`" in text, name
    assert all(kind.title and kind.remedy for kind in KINDS.values())  # what GET /problems/{name} says


def test_every_key_of_spec_and_mesh_is_documented() -> None:
    text = page("http")
    for name in [*keys_of(MeshSpec), *keys_of(schwarz_schema.Schwarz)]:
        assert re.search(rf"[`.\"]{name}[`.\",]", text), name


def undescribed(schemas: dict[str, Any], text: str) -> set[str]:
    """The keys of objects that neither say what they are, nor are objects with a description, nor stand in the text."""
    return {
        f"{name}.{key}"
        for name, schema in schemas.items()
        for key, value in schema.get("properties", {}).items()
        if not {"description", "const"} & value.keys()
        and "$ref" not in str(value)
        and not re.search(rf"[`.\"]{key}[`.\",:]", text)
    }


def test_the_openapi_document_describes_every_object_and_key() -> None:
    schemas = openapi()["components"]["schemas"]
    assert [name for name, schema in schemas.items() if not schema.get("description")] == []
    assert undescribed(schemas, page("http")) == set()
    schemas["Timings"]["properties"]["novel"] = {"type": "number"}
    assert undescribed(schemas, page("http")) == {"Timings.novel"}


def test_every_key_of_the_convergence_is_documented() -> None:
    schemas = openapi()["components"]["schemas"]
    u = Expression("x*y")
    problem = Problem(monitor=ArcLength(u=u), grid=Grid(n_xi=8, n_eta=8))
    found = solve(problem, Schwarz(subdomains=(2, 1), overlap=2)).convergence()
    iteration = found["iterations"][-1]
    assert found.keys() <= schemas["ConvergenceHistory"]["properties"].keys()
    assert iteration.keys() <= schemas["IterationHistory"]["properties"].keys()
    assert iteration["subdomains"][0].keys() <= schemas["SubdomainHistory"]["properties"].keys()


def test_every_choice_is_documented() -> None:
    for name in ("http", "choose-settings", "theory"):
        assert all(f"`{kind}`" in page(name) for kind in Boundary), name
    for choice in (*Ordering, *Acceleration, *LocalSolver, *LineData, *Initial, *CELLS):
        assert f"`{choice}`" in command_pages()[COMMANDS], choice
    for name in ("http", "cli", "choose-settings", "choose-a-transmission-condition"):
        assert all(f"`{kind}`" in page(name) for kind in schwarz_schema.TRANSMISSIONS.documents), name


def test_every_status_is_documented() -> None:
    rows = re.findall(r"^\| `(\w+)` \| ([^|]+) \| ([^|]*)\|$", page("choose-settings"), re.MULTILINE)
    assert {row[0] for row in rows} >= {str(status) for status in Status}
    for status in Status:
        assert f"`{status}`" in page("http")


def test_every_format_is_documented() -> None:
    text = page("formats")
    for form in FORMATS.values():
        row = rf"^\| `{form.name}`.* \| `{re.escape(form.suffix)}` \| `{re.escape(form.media_type)}` \|"
        assert re.search(row, text, re.MULTILINE), form.name
    table = text.split("## Mesh files")[1].split("## ")[0]
    assert set(row_names(table)) >= set(FORMATS)
    samples = page("samples").split("## Files")[1]
    assert set(row_names(samples.split("## ")[0])) == set(READERS)
    assert all(f"`{measure}`" in page("theory") for measure in PER_CELL)


def test_every_format_of_parts_is_documented() -> None:
    text = page("formats").partition("## Meshes in parts")[2].partition("\n## ")[0]
    for kind in PARTED_FORMATS.values():
        row = next(line for line in text.splitlines() if line.startswith(f"| `{kind.name}` |"))
        _, _, head, parts, readers, nodes, _ = (cell.strip() for cell in row.split("|"))
        assert head == f"`{kind.suffix}`"
        assert parts == (f"`{kind.part_suffix}`" if kind.part_suffix else "chunks of one store")
        assert nodes.startswith("in both parts") is (kind.name == "pvtu")
        assert all(name in readers for name in re.findall(r"VTK|PyVista|ParaView|h5py|zarr|xarray|Dask", kind.readers))
        assert f"**{kind.name}**" in text


def test_every_function_of_expressions_is_documented_and_exists() -> None:
    table = page("expressions").split("| function | returns |")[1].split("\n\n")[0]
    told = {re.split(r"\W", word)[0] for word in row_names(table)}
    assert told == set(FUNCTIONS)


def test_every_limit_of_expressions_is_documented() -> None:
    text = page("expressions")
    for name in LIMITS.__dataclass_fields__:
        value = f"{getattr(LIMITS, name):g}".replace("e+", "e")
        assert re.search(rf"^\| `{name}`[^|]*\| {re.escape(value)}\b", text, re.MULTILINE), name


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("http", f"objects and lists inside one another, {document.MAX_KEYS} keys, {document.MAX_TEXTS:,} texts of"),
        ("http", f"JSON has at most {document.MAX_DEPTH} objects and lists"),
        ("http", f"A description has at most {document.MAX_LISTS_OF_OBJECT} vertices"),
        ("http", f"2 to {curve.MAX_POINTS} points of a cubic spline"),
        ("http", f"`fields` are up to {sequences.MAX_FIELDS} fields to carry to the next mesh, of at most"),
        ("http", f"mesh, of at most {sequences.MAX_COMPONENTS} components together"),
        ("http", f"a vector has at most {mesh_values.MAX_COMPONENTS} components"),
        ("formats", f"Coordinates have at most {abaqus.MAX_WIDTH} characters, names {abaqus.MAX_NAME}"),
        ("formats", f"with the number of the side, at most {spectral.MAX_LABELS}."),
        ("samples", f"(at most {samples.MAX_BEYOND} beyond)"),
        ("finite-volumes", f"in degrees, over 0 and at most {monitor.MAX_ORTHOGONALITY:g}."),
        ("python", f"up to {one_strip.MAX_SWEEPS_AT_ONCE} sweeps are made at a"),
        ("choose-settings", f"on meshes of {rows.MIN_SHARED_NODES:,} points".replace(",", " ")),
    ],
)
def test_limits_are_those_of_the_code(name: str, told: str) -> None:
    assert told in re.sub(r"\s+", " ", page(name))


def test_the_symbol_table_names_what_there_is() -> None:
    table = page("theory").split("## Symbols")[1].split("## ")[0]
    for module in re.findall(r"`(equimesh\.[\w.]+)`", page("theory")):
        assert (ROOT / "solver" / Path(*module.split("."))).with_suffix(".py").exists(), module
    source = "\n".join(path.read_text() for path in (ROOT / "solver" / "equimesh").rglob("*.py"))
    for name in re.findall(r"`([A-Z]\w+)(?:\.\w+)?`", table):
        assert re.search(rf"^class {name}\b", source, re.MULTILINE), name


def test_every_option_of_the_client_is_named_and_its_docstring_has_its_default() -> None:
    text = page("client").split("### `generate(u, n, *, ...)`")[1].split("### ")[0]
    parameters = inspect.signature(Client.generate).parameters.values()
    keywords = {p.name for p in parameters if p.kind is p.KEYWORD_ONLY}
    assert [name for name in {*DEFAULTS, *keywords} if not re.search(rf"`{name}\b", text)] == []
    source = inspect.getsource(MeshOptions)
    told = dict(re.findall(r'^    (\w+): .*\n    """((?:.|\n)*?)"""', source, re.MULTILINE))
    for name, value in DEFAULTS.items():
        word = f'"{value}"`` (default)' if isinstance(value, str) else f"Default: {value}"
        assert word in " ".join(told[name].split()), name


def test_the_tree_of_exceptions_is_that_of_the_client() -> None:
    from equimesh_client import errors

    tree = next(code for kind, code in blocks(page("client")) if kind == "text")
    drawn = [line.strip() for line in (errors.__doc__ or "").splitlines() if line.startswith("    ")]
    assert [line.strip() for line in tree.splitlines()] == drawn


def undocumented(names: Iterable[str]) -> list[str]:
    """The names of the package without a docstring of their own, of those that the page does not show."""
    shown = {name for name in names if re.search(rf"\b{name}\b", page("python"))}
    return [name for name in names if name not in shown and not (getattr(equimesh, name).__doc__ or "").strip()]


def test_every_public_name_is_on_the_page_of_python_or_has_a_docstring(monkeypatch: pytest.MonkeyPatch) -> None:
    assert undocumented(equimesh.__all__) == []
    assert undocumented(["Problem", "Grid"]) == []
    monkeypatch.setattr(equimesh, "Novel", type("Novel", (), {}), raising=False)
    assert undocumented(["Problem", "Novel"]) == ["Novel"]
