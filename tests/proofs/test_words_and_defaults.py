"""The words and defaults of a spec: equal in solver, service, client, command line and documentation.

The solver's are the measure. Defaults are compared through what is built: a short document, and the same document as
another side completes it, must become equal problems.
"""

from __future__ import annotations

import inspect
import json
import re
from ast import literal_eval
from dataclasses import fields
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

import pytest

import equimesh as em
from equimesh.io.write import CELLS
from equimesh.monitors.auto import PURPOSES
from equimesh.monitors.curvature import NORMS
from equimesh.monitors.monitor import orthogonality_of
from equimesh.monitors.tensor import MAPS
from equimesh.specs import BuiltSpec, build
from equimesh_cli.command import build_parser
from equimesh_cli.options import problem
from equimesh_client import Client
from equimesh_client.spec import domains as client_domains
from equimesh_client.spec import mesh as client_mesh
from equimesh_client.spec import schwarz as client_schwarz
from equimesh_client.spec.monitors import monitor_json
from equimesh_schema import monitors as schema
from equimesh_schema.document import keys_of
from equimesh_schema.sources import ExpressionSource
from equimesh_service.api.checks import MODE_USES
from equimesh_service.spec import domains, schwarz
from equimesh_service.spec.mesh import GridSpec, MeshSpec, TargetSpec, read_spec

DOCS = Path(__file__).parents[2] / "docs"
U, ONE, NOTHING = {"expression": "x*y"}, {"expression": "1"}, {"expression": "0"}
SIDES: dict[str, Any] = {
    "bottom": {"x": "t", "y": "0"},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"x": "t", "y": "1"},
    "left": {"points": [[0, 0], [0, 1]]},
}
AXIS = [k / 63 for k in range(64)]
NODAL: dict[str, Any] = {
    "nodal": {"x": [[s] * 64 for s in AXIS], "y": [AXIS] * 64, "values": [[s * t for t in AXIS] for s in AXIS]}
}
ARC: dict[str, Any] = {"kind": "arc_length", "u": U}
WEIGHT: dict[str, Any] = {"kind": "weight", "rho": ONE}
MONITORS: dict[str, dict[str, Any]] = {
    "auto": {"kind": "auto", "u": U},
    "least_error": {"kind": "least_error", "u": U},
    "nodal_solution": {"kind": "nodal_solution", "u": NODAL},
    "arc_length": ARC,
    "curvature": {"kind": "curvature", "u": U},
    "weight": WEIGHT,
    "tensor": {"kind": "tensor", "m11": ONE, "m12": NOTHING, "m22": ONE},
    "intersection": {"kind": "intersection", "monitors": [ARC, WEIGHT]},
}
DOMAINS: dict[str, dict[str, Any]] = {
    "rectangle": {"kind": "rectangle"},
    "annulus_sector": {"kind": "annulus_sector"},
    "quadrilateral": {"kind": "quadrilateral", **SIDES},
}
SQUARE: dict[str, Any] = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 3]}],
}
BLOCKS: dict[str, dict[str, Any]] = {
    "blocks": {"kind": "blocks", **SQUARE},
    "mesh": {"kind": "mesh", "file": "square.json"},
}
CONDITIONS = {kind.name: {"kind": kind.name} for kind in get_args(em.TransmissionCondition)}
DOCUMENTS: dict[str, dict[str, Any]] = {
    "least": {"monitor": {"u": U}},
    **{name: {"monitor": monitor} for name, monitor in MONITORS.items()},
    **{name: {"monitor": ARC, "domain": domain} for name, domain in DOMAINS.items()},
    "schwarz": {"monitor": ARC, "schwarz": {}},
    **{name: {"monitor": ARC, "schwarz": {"transmission": condition}} for name, condition in CONDITIONS.items()},
}
WORDS: dict[str, list[str]] = {
    "monitor": list(MONITORS),
    "domain": [*DOMAINS, *BLOCKS],
    "transmission": list(CONDITIONS),
    "norm": list(NORMS),
    "map": list(MAPS),
    "boundary": list(em.Boundary),
    "initial": list(em.Initial),
    "mode": list(em.Mode),
    "cells": list(CELLS),
    "interface_data": list(em.LineData),
    "ordering": list(em.Ordering),
    "acceleration": ["auto", *em.Acceleration],
    "local_solver": list(em.LocalSolver),
}


def known(document: dict[str, Any], *path: str, key: str = "?") -> set[str]:
    """What the solver knows in the place of ``key`` of an object of the document: it lists that when it refuses it."""
    changed = json.loads(json.dumps(document))
    place = changed
    for name in path:
        place = place[name]
    place[key] = "?"
    with pytest.raises(em.InputError) as caught:
        build(changed)
    names = re.split("known are |choose one of ", caught.value.message)[1:]
    return set(re.findall(r"'(\w+)'", names[0].partition("; did you mean")[0])) if names else set()


def words_of(model: Any, name: str) -> list[str]:
    return list(get_args(model.model_fields[name].annotation))


def kinds_of(union: Any) -> list[str]:
    return [words_of(model, "kind")[0] for model in get_args(union)]


def test_the_table_of_words_is_that_of_the_solver() -> None:
    assert known(DOCUMENTS["least"], "monitor", key="kind") == {*WORDS["monitor"]}
    assert known(DOCUMENTS["rectangle"], "domain", key="kind") == {*WORDS["domain"]}
    assert known(DOCUMENTS["classical"], "schwarz", "transmission", key="kind") == {*WORDS["transmission"]}


def test_words_of_monitors() -> None:
    assert list(schema.MONITORS.documents) == WORDS["monitor"]
    assert list(get_args(schema.Norm)) == WORDS["norm"]
    assert list(get_args(get_type_hints(schema.Weight)["map"])) == WORDS["map"]
    assert get_args(get_type_hints(schema.Auto)["purpose"])[0] == Literal[PURPOSES]


def test_words_of_the_service() -> None:
    settings = schwarz.SchwarzSpec
    assert {
        "domain": kinds_of(domains.AnyDomain),
        "transmission": sorted(kinds_of(schwarz.AnyTransmission), key=WORDS["transmission"].index),
        **{name: words_of(MeshSpec, name) for name in ("boundary", "initial", "mode", "cells")},
        "interface_data": words_of(schwarz.OptimizedSpec, "data"),
        **{name: words_of(settings, name) for name in ("ordering", "acceleration", "local_solver")},
    }.items() <= WORDS.items()
    assert {**domains.USES}.keys() == {*WORDS["domain"]}
    for name, uses in (
        ("mode", MODE_USES),
        ("transmission", schwarz.TRANSMISSION_USES),
        ("interface_data", schwarz.INTERFACE_DATA_USES),
        ("ordering", schwarz.ORDERING_USES),
        ("acceleration", {"auto": "", **schwarz.ACCELERATION_USES}),
        ("local_solver", schwarz.LOCAL_SOLVER_USES),
    ):
        assert {*uses} == {*WORDS[name]}, name


@pytest.mark.parametrize("name", DOCUMENTS)
def test_defaults_and_keys_of_the_service(name: str) -> None:
    document = DOCUMENTS[name]
    canonical = read_spec(document).canonical
    assert build(canonical) == build(document)
    assert canonical.keys() == MeshSpec.model_fields.keys() == known(document)
    assert canonical["grid"].keys() == GridSpec.model_fields.keys() == known({**document, "grid": {}}, "grid")
    assert canonical["monitor"].keys() - {"kind"} == known(document, "monitor")
    assert canonical["domain"].keys() - {"kind"} == known({"domain": {}, **document}, "domain")
    if "expression" in document["monitor"].get("u", {}):
        assert {*keys_of(ExpressionSource)} == known(document, "monitor", "u")
    aimed = {**document, "target": {"error": 1}}
    if "schwarz" not in document:
        assert TargetSpec.model_fields.keys() == known(aimed, "target")
    if "u" in document["monitor"] and "schwarz" not in document and name != "nodal_solution":
        completed = read_spec(aimed).canonical
        assert completed["grid"] is None
        assert build(completed) == build(aimed)
    if "schwarz" in document:
        assert canonical["schwarz"].keys() == known(document, "schwarz")
    if document.get("schwarz"):
        assert canonical["schwarz"]["transmission"].keys() - {"kind"} == known(document, "schwarz", "transmission")


def test_the_iteration_between_blocks_on_all_sides() -> None:
    document = {"monitor": MONITORS["least_error"], "domain": BLOCKS["blocks"], "schwarz": {}}
    canonical = read_spec(document).canonical["schwarz"]
    sent = client_schwarz.BlockSchwarz().json()
    names = {one.name: one.default for one in fields(em.BlockSchwarz)}
    assert canonical == sent == names
    assert known(document, "schwarz") == names.keys()
    for settings in (canonical, sent, {}):
        assert build({**document, "schwarz": settings}).schwarz == em.BlockSchwarz()
    page = (DOCS / "reference" / "http.md").read_text().split("### Blocks")[1].split("## POST")[0]
    rows = re.findall(r"^\| `(\w+)` \| `([^`]+)`", page, re.MULTILINE)
    assert {name: json.loads(default) for name, default in rows} == names


@pytest.mark.parametrize("name", BLOCKS)
def test_keys_of_blocks_on_all_sides(name: str) -> None:
    def find(_: str, settings: Any) -> em.Blocks:
        assert not settings
        return em.Blocks.of(SQUARE)

    document = {"monitor": MONITORS["least_error"], "domain": BLOCKS[name]}
    canonical = read_spec(document).canonical
    known_keys = known({"monitor": ARC, "domain": BLOCKS[name]}, "domain")
    assert canonical["domain"].keys() - {"kind"} == known_keys
    made, completed = (build(one, find_mesh=find).problem.domain for one in (document, canonical))
    assert isinstance(made, em.Blocks)
    assert isinstance(completed, em.Blocks)
    assert (made.mesh.points == completed.mesh.points).all()
    domain = client_domains.Blocks(**SQUARE) if name == "blocks" else client_domains.MeshFile(file="square.json")
    assert domain.json().keys() == canonical["domain"].keys()
    assert {key: value for key, value in domain.json().items() if key != "refine"} == {
        key: value for key, value in canonical["domain"].items() if key != "refine"
    }


def read(function: object) -> dict[str, Any]:
    return {"nodal": function} if isinstance(function, dict) else {"expression": function}


CLIENT_MONITORS: dict[str, tuple[schema.AnyMonitor, str | None]] = {
    "auto": (schema.Auto(), "x*y"),
    "least_error": (schema.LeastError(), "x*y"),
    "nodal_solution": (schema.NodalSolution(u=NODAL["nodal"]), None),
    "arc_length": (schema.ArcLength(), "x*y"),
    "curvature": (schema.Curvature(), "x*y"),
    "weight": (schema.Weight("1"), None),
    "tensor": (schema.Tensor("1", "0", "1"), None),
    "intersection": (
        schema.Intersection([schema.ArcLength(), schema.Weight("1")]),
        "x*y",
    ),
}
CLIENT_DOMAINS: dict[str, client_domains.Domain] = {
    "rectangle": client_domains.Rectangle(),
    "annulus_sector": client_domains.AnnulusSector(),
    "quadrilateral": client_domains.Quadrilateral(
        bottom=("t", "0"), right=[[1, 0], [1, 1]], top=("t", "1"), left=[[0, 0], [0, 1]]
    ),
}
CLIENT_CONDITIONS = {name: client_schwarz.transmission(name) for name in CONDITIONS}


def test_words_of_the_client() -> None:
    assert {
        "domain": list(client_domains.KINDS),
        "transmission": sorted(client_schwarz.TRANSMISSIONS, key=WORDS["transmission"].index),
    }.items() <= WORDS.items()
    # the other words are strings that only the service checks: the docstrings of the client name them all
    for described, names in (
        (inspect.getsource(client_mesh.MeshOptions), ("boundary", "mode")),
        (str(Client.generate.__doc__), ("initial", "cells")),
        (str(client_schwarz.Optimized.__doc__), ("interface_data",)),
        (str(client_schwarz.Schwarz.__doc__), ("ordering", "acceleration", "local_solver")),
    ):
        named = {*re.findall(r'``"(\w+)"``', described)}
        assert named >= {word for name in names for word in WORDS[name]}, names


def test_defaults_and_keys_of_the_client() -> None:
    points = inspect.signature(Client.generate).parameters["n"].default
    for name, (monitor, u) in CLIENT_MONITORS.items():
        sent = client_mesh.mesh_spec(monitor_json(monitor, read, u), points)
        assert build(sent) == build(DOCUMENTS[name]), name
        assert {*keys_of(type(monitor))} - {"kind"} == known(DOCUMENTS[name], "monitor"), name
    for name, domain in CLIENT_DOMAINS.items():
        assert build({"monitor": ARC, "domain": domain.json()}) == build(DOCUMENTS[name]), name
        assert domain.json().keys() - {"kind"} == known(DOCUMENTS[name], "domain"), name
    for name, condition in CLIENT_CONDITIONS.items():
        sent = client_schwarz.Schwarz(transmission=condition).json()
        assert build({"monitor": ARC, "schwarz": sent}) == build(DOCUMENTS[name]), name
        assert sent.keys() == known(DOCUMENTS[name], "schwarz"), name
        assert sent["transmission"].keys() - {"kind"} == known(DOCUMENTS[name], "schwarz", "transmission"), name
    assert build({"monitor": ARC, "schwarz": client_schwarz.Schwarz().json()}) == build(DOCUMENTS["schwarz"])
    aimed = client_mesh.mesh_spec(ARC, points, {"target": client_mesh.Target(error=1)})
    assert build(aimed) == build({"monitor": ARC, "target": {"error": 1}})
    assert aimed["target"].keys() == TargetSpec.model_fields.keys()


COMMANDS = {
    "least": "x*y",
    "auto": "x*y --monitor auto",
    "least_error": "x*y --monitor least-error",
    "arc_length": "x*y --monitor arc-length",
    "curvature": "x*y --monitor curvature",
    "weight": "--monitor weight --rho 1",
    "tensor": "--monitor tensor --m11 1 --m12 0 --m22 1",
    "rectangle": "x*y --monitor arc-length --domain rectangle:0,1,0,1",
    "annulus_sector": "x*y --monitor arc-length --domain annulus:1,2,0,90",
    "schwarz": "x*y --monitor arc-length --subdomains 2x1",
    **{name: f"x*y --monitor arc-length --subdomains 2x1 --transmission {name}" for name in CONDITIONS},
}
DEFAULTS = {
    "--monitor": schema.MONITORS.default,
    "--distortion": em.LeastError.distortion,
    "--smoothness": em.LeastError.smoothness,
    "-a": em.ArcLength.a,
    "-b": em.ArcLength.b,
    "--scaled": em.ArcLength.scaled,
    "--norm": em.Curvature.norm,
    "--target-norm": em.Target.norm,
    "--map": em.Weight.map,
    "--smoothing": 0.0,
    "--n-xi": build(DOCUMENTS["least"]).problem.grid.n_xi,
    "--boundary": em.Problem.boundary,
    "--initial": build(DOCUMENTS["least"]).initial,
    "--mode": build(DOCUMENTS["least"]).mode,
    "--cells": build(DOCUMENTS["least"]).cells,
    "--overlap": em.Schwarz.overlap,
    "--transmission": em.Schwarz().transmission.name,
    "--interface-data": em.Optimized.data,
    "--p": em.LinearRobin.p,
    "--ordering": em.Schwarz.ordering,
    "--line-correction": em.Schwarz.line_correction,
    "--acceleration": em.Schwarz.acceleration,
    "--local-solver": em.Schwarz.local_solver,
    "--tolerance": em.Schwarz.tolerance,
    "--max-iterations": em.Schwarz.max_iterations,
}


def test_what_bounds_angles_is_the_same_on_all_sides() -> None:
    auto = {"kind": "auto", "u": U, "for": "finite_volume", "orthogonality": 40.0}
    least = {"kind": "least_error", "u": U, "rectilinear": True, "orthogonality": 40.0}
    for document in (auto, least):
        assert build({"monitor": read_spec({"monitor": document}).canonical["monitor"]}) == build({"monitor": document})
    sent = [
        schema.Auto(purpose="finite_volume", orthogonality=40.0),
        schema.LeastError(rectilinear=True, orthogonality=40.0),
    ]
    for monitor, document in zip(sent, (auto, least), strict=True):
        assert build({"monitor": monitor_json(monitor, read, "x*y")}) == build({"monitor": document})
    for words, document in (
        ("x*y --for finite-volume --orthogonality 40", auto),
        ("x*y --monitor least-error --rectilinear --orthogonality 40", least),
    ):
        options = build_parser("solve").parse_args(["solve", *words.split()])
        assert problem.build(options) == build({"monitor": document})
    for name, monitor in MONITORS.items():
        bounded = {**monitor, "orthogonality": 40.0}
        assert orthogonality_of(build({"monitor": bounded}).problem.monitor) == 40.0, name
        assert build(read_spec({"monitor": bounded}).canonical) == build({"monitor": bounded}), name


def test_defaults_of_the_command_line() -> None:
    def built(words: str) -> BuiltSpec:
        return problem.build(build_parser("solve").parse_args(["solve", *words.split()]))

    for name, words in COMMANDS.items():
        assert built(words) == build(DOCUMENTS[name]), name
    assert built("x*y --target-error 1e-3") == build({**DOCUMENTS["least"], "target": {"error": 1e-3}})


@pytest.mark.parametrize("command", ["solve", "generate"])
def test_words_of_the_command_line_and_defaults_that_its_help_names(command: str) -> None:
    subparsers = next(action for action in build_parser(command)._actions if hasattr(action, "add_parser"))
    actions = {flag: action for action in subparsers.choices[command]._actions for flag in action.option_strings}  # type: ignore[union-attr, call-overload, index]
    for name, words in WORDS.items():
        if name == "monitor":
            assert list(actions["--monitor"].choices) == [w.replace("_", "-") for w in words if w != "intersection"]  # type: ignore[arg-type]
        elif name != "domain":
            assert sorted(actions[f"--{name.replace('_', '-')}"].choices) == sorted(words), name  # type: ignore[arg-type]
    assert actions["--for"].choices == tuple(word.replace("_", "-") for word in PURPOSES)
    for flag, default in DEFAULTS.items():
        assert re.search(rf"\({re.escape(str(default))}[:)]", actions[flag].help or ""), flag


def test_defaults_that_the_page_of_the_command_line_names() -> None:
    rows = re.findall(r"^\| (`[^|]+`) \| ([^|]*) \|", (DOCS / "reference" / "cli.md").read_text(), re.MULTILINE)
    named = {flag: default.strip("`") for flags, default in rows for flag in re.findall(r"`(-[\w-]+)", flags)}
    assert {flag: named[flag] for flag in DEFAULTS} == {flag: str(default) for flag, default in DEFAULTS.items()}


def test_words_and_defaults_of_the_page_on_the_interface() -> None:
    page = (DOCS / "reference" / "http.md").read_text()
    spec = page.split("## The spec")[1].split("## POST")[0]
    shown = json.loads(re.findall(r"```json\n(.*?)```", spec, re.DOTALL)[0])
    assert shown.keys() == MeshSpec.model_fields.keys()
    assert build(shown) == build({"monitor": {"u": shown["monitor"]["u"]}})
    settings = read_spec(DOCUMENTS["schwarz"]).canonical["schwarz"]
    rows = re.findall(r"^\| `schwarz\.(\w+)` \| `([^`]+)`", spec, re.MULTILINE)
    assert {name: json.loads(default) for name, default in rows} == settings
    rows = re.findall(r"^\| (`.+?`)[^|]* \| (.+) \|$", spec, re.MULTILINE)
    cells = {name: row for names, row in rows for name in re.findall(r"`([\w.]+)`", names)}
    for name in ("boundary", "initial", "mode", "cells"):
        assert re.findall(r"`(\w+)`", cells[name])[: len(WORDS[name])] == [*WORDS[name]], name
    for name in ("ordering", "acceleration", "local_solver"):
        assert {*re.findall(r'`"(\w+)"`', cells[f"schwarz.{name}"])} >= {*WORDS[name]}, name
    for name, completed in {**MONITORS, **DOMAINS}.items():
        part = "monitor" if name in MONITORS else "domain"
        keys = read_spec({"monitor": ARC, part: completed}).canonical[part]
        told = re.findall(r"`(\w+)` \(`?(\[.*?\]|\"?[\w.]+\"?)", cells[name].split(" | ")[0])
        assert {key: keys[key] for key, _ in told} == {key: json.loads(default) for key, default in told}, name
        plain = {key for key, value in keys.items() if isinstance(value, float | bool | str | list)}
        assert {key for key, _ in told} == plain - {"kind", "smoothing", "monitors"}, name


def test_defaults_that_the_page_on_python_names() -> None:
    page = (DOCS / "reference" / "python.md").read_text()
    found = 0
    for name, arguments in re.findall(
        r"`(Auto|LeastError|Target|ArcLength|Curvature|Rectangle|AnnulusSector)\(([^`]*)\)`", page
    ):
        for key, value in re.findall(r"(\w+)=(\([^)]*\)|[^,()]+)", arguments):
            parameter = inspect.signature(getattr(em, name)).parameters.get(key)
            if parameter is not None and parameter.default is not parameter.empty:
                assert literal_eval(value) == parameter.default, (name, key)
                found += 1
    assert found >= 14
