"""The house itself: import circles, sizes of files, faces, and names in docs that lead somewhere."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import re
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = {
    **dict.fromkeys(("equimesh", "equimesh_cluster"), "solver"),
    "equimesh_service": "service",
    **dict.fromkeys(("equimesh_client", "equimesh_coupling", "equimesh_schema", "equimesh_cli"), "client"),
}
FACES = {
    *("equimesh", "equimesh_cluster", "equimesh_client", "equimesh_coupling", "equimesh_schema", "equimesh_service"),
    *(f"equimesh.{name}" for name in ("io", "plot", "upload", "quality", "schwarz", "meshes", "specs", "testing")),
}
MAX_LINES, MAX_TEST_LINES = 600, 800  # of a file
CODE = re.compile(r"^```(?:python|py)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
DOTTED = re.compile(
    r"(?<![\w./:-])(?:equimesh|equimesh_(?:client|cluster|coupling|schema|cli|service))(?:\.[A-Za-z_]\w*)+(?![\w/:])"
)
FILE = re.compile(r"(?<![\w/])(?:tests|service|solver|client|examples|benchmarks|docs)/[\w./-]+\.\w+")
# Files, and a logger.
NOT_NAMES = {
    "equimesh.env",
    "equimesh.sqlite3",
    "equimesh_service.access",
    *(f"equimesh.{end}" for end in ("c", "h", "o", "m", "f90")),
}


def pages() -> dict[str, str]:
    """The text of every page, of the changelog its first section."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
    texts = {path.relative_to(ROOT).as_posix(): path.read_text() for path in paths}
    return texts | {"CHANGELOG.md": "".join(re.split(r"^(?=## )", (ROOT / "CHANGELOG.md").read_text(), flags=re.M)[:2])}


def sources() -> list[Path]:
    return [path for name, root in PACKAGES.items() for path in sorted((ROOT / root / name).rglob("*.py"))]


def circles(imports: dict[str, set[str]]) -> list[set[str]]:
    """The sets of modules that import each other, directly or through others."""

    @cache
    def reached(module: str) -> frozenset[str]:
        seen, todo = set[str](), list(imports[module])
        while todo:
            if (found := todo.pop()) not in seen:
                seen.add(found)
                todo.extend(imports[found])
        return frozenset(seen)

    found = {frozenset(other for other in reached(m) if m in reached(other)) for m in imports if m in reached(m)}
    return [set(circle) for circle in found]


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=False)
    imports = {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    assert len(imports) > 200
    assert circles(imports) == []
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == [{"b", "c"}]


def test_no_file_is_too_long() -> None:
    files = [path for name in ("client", "service", "solver", "tests") for path in (ROOT / name).rglob("*.py")]
    long = {path: lines for path in files if (lines := path.read_text().count("\n")) > _max_lines(path)}
    assert long == {}, "another noun has a file of its own"


def _max_lines(path: Path) -> int:
    return MAX_TEST_LINES if path.relative_to(ROOT).parts[0] == "tests" else MAX_LINES


def imported(code: str) -> Iterator[str]:
    """The modules of the project that code imports."""
    for node in ast.walk(ast.parse(code)):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
        yield from (name for name in names if name.split(".")[0] in PACKAGES)


def test_no_test_stops_the_clock_of_its_process() -> None:
    """A service of the session would sleep in its event loop until the clock shows the time that a test set."""
    patched = re.compile(r"setattr\((?:\w+\.)?time, \"(?:monotonic|perf_counter|sleep)\"")
    found = [str(path.relative_to(ROOT)) for path in (ROOT / "tests").rglob("*.py") if patched.search(path.read_text())]
    assert found == [], "replace the name `time` in the module that is tested"


def test_examples_and_docs_import_faces_only() -> None:
    codes = {path.name: path.read_text() for path in (ROOT / "examples").glob("*.py")}
    codes |= {f"{name}, block {k}": code for name, text in pages().items() for k, code in enumerate(CODE.findall(text))}
    assert len(codes) > 40
    assert {name: set(imported(code)) - FACES for name, code in codes.items() if set(imported(code)) - FACES} == {}


def modules_without_face() -> list[Path]:
    names = {
        path: ".".join(path.parent.relative_to(ROOT).parts[1:]) for path in sources() if path.name == "__init__.py"
    }
    return [path for path, name in names.items() if name not in FACES | {"equimesh_cli"}]


def test_a_package_that_is_no_face_says_one_sentence_and_imports_nothing() -> None:
    for path in modules_without_face():
        match ast.parse(path.read_text()).body:
            case [ast.Expr(value=ast.Constant(value=str(sentence)))]:
                assert re.fullmatch(r"[^\n]+\.", sentence), path
            case _:
                raise AssertionError(f"{path} has more than a docstring")


def test_layers_of_all_packages_are_exhaustive() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layered = [contract for contract in contracts if contract["type"] == "layers"]
    assert all(contract.get("exhaustive") for contract in layered)
    assert {name for contract in layered for name in contract["containers"]} >= set(PACKAGES)


@cache
def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or a member of one; fields and attributes of instances count."""
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        module = ".".join(parts[:length])
        try:
            spec = importlib.util.find_spec(module)
        except ModuleNotFoundError:
            continue
        # A folder that a move left without code is no module: imported, it would take the place of a public name.
        if spec is not None and spec.origin is not None:
            return _has(importlib.import_module(module), parts[length:])
    return False


def _has(found: object, parts: list[str]) -> bool:
    for k, part in enumerate(parts):
        if not hasattr(found, part):
            return k == len(parts) - 1 and inspect.isclass(found) and _is_attribute(found, part)
        found = getattr(found, part)
    return True


def _is_attribute(owner: type, name: str) -> bool:
    return any(
        name in vars(base).get("__annotations__", {}) or re.search(rf"self\.{name}\b.*=", inspect.getsource(base))
        for base in owner.__mro__
        if base.__module__.split(".")[0] in PACKAGES
    )


def names_in(text: str) -> set[str]:
    return set(DOTTED.findall(text)) - NOT_NAMES


def test_names_and_files_in_pages_exist() -> None:
    missing = {name: _missing_in(text) for name, text in pages().items()}
    assert {name: found for name, found in missing.items() if found} == {}


def _missing_in(text: str) -> set[str]:
    names = {dotted for dotted in names_in(text) if not resolves(dotted)}
    return names | {file for file in FILE.findall(text) if not (ROOT / file).exists() and "*" not in file}


def docstrings(path: Path) -> Iterator[str]:
    left: list[ast.AST] = [ast.parse(path.read_text())]
    while left:  # statements alone: most nodes are parts of expressions
        node = left.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield ast.get_docstring(node) or ""
        left += [n for n in ast.iter_child_nodes(node) if isinstance(n, ast.stmt | ast.excepthandler | ast.match_case)]


def test_names_in_docstrings_exist() -> None:
    missing = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources()
        for text in docstrings(path)
        for name in names_in(re.sub(r"\s*\n\s*", " ", text))
        if not resolves(name)
    }
    assert missing == set()


def test_a_name_that_is_gone_is_seen() -> None:
    assert resolves("equimesh.Solution.status")
    assert resolves("equimesh.quality.measures.Quality.q_eq")
    assert not resolves("equimesh.solutions")
    assert not resolves("equimesh.Solution.colour")
    assert names_in("``equimesh.chord``, equimesh.env") == {"equimesh.chord"}
