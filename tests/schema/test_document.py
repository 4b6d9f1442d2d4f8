"""Documents as dataclasses, validated by pydantic without importing it."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Literal, get_args, get_type_hints

import pytest
from pydantic import TypeAdapter, ValidationError

import equimesh as em
from equimesh.io.write import CELLS
from equimesh.monitors.least_error import PURPOSES
from equimesh.monitors.metrics import NORMS
from equimesh.specs import build
from equimesh_client.spec.request import monitor_json
from equimesh_schema import domains, mesh, monitors, schwarz
from equimesh_schema.document import (
    Document,
    Either,
    Limits,
    Pair,
    Shown,
    Words,
    by_kind,
    described,
    docs_of,
    keys_of,
    required_of,
    types_of,
)
from equimesh_schema.monitors import FUNCTIONS, MEMBERS, MONITORS, REQUIRED_FUNCTIONS, LeastError, Weight
from equimesh_schema.notebook import MAX_WARNINGS, html_of
from equimesh_schema.settings import choices, setting_of, settings_of
from equimesh_schema.sources import Function, functions_of
from equimesh_service.spec.mesh import read_spec

NUMBER = Annotated[float, described("A number.")]


@dataclass(frozen=True, kw_only=True)
class Leaf(Document):
    """A leaf."""

    kind: str = "leaf"
    size: NUMBER = 1.0
    of_python: int | None = None
    """Named otherwise."""

    JSON_NAMES: ClassVar = {"of_python": "of-json"}
    NEEDED: ClassVar = ("size",)


@dataclass(frozen=True, kw_only=True)
class Stone(Document):
    """A stone."""

    kind: str = "stone"


THINGS = by_kind(Leaf, Stone, default="leaf")


@dataclass(frozen=True, kw_only=True)
class Tree(Document):
    """A tree."""

    first: Annotated[Any, THINGS]
    others: Annotated[list[Annotated[Any, THINGS]], Limits(max_length=2)] = field(default_factory=list)


TREES = TypeAdapter(Tree)


def faults(document: object, context: object = None) -> list[tuple[str, str]]:
    with pytest.raises(ValidationError) as caught:
        TREES.validate_python(document, context=context)
    return [
        (".".join(str(part) for part in one["loc"] if not str(part).startswith("\x00")), one["type"])
        for one in caught.value.errors()
    ]


def test_a_document_is_read() -> None:
    tree = TREES.validate_python({"first": {"size": 2, "of-json": 3}, "others": [{"kind": "stone"}]})
    assert tree == Tree(first=Leaf(size=2.0, of_python=3), others=[Stone()])
    assert TREES.dump_python(tree, by_alias=True) == {
        "first": {"kind": "leaf", "size": 2.0, "of-json": 3},
        "others": [{"kind": "stone"}],
    }


@pytest.mark.parametrize(
    ("document", "place", "fault"),
    [
        ({}, "first", "missing"),
        ({"first": {}}, "first.size", "missing"),
        ({"first": {"size": "2"}}, "first.size", "float_type"),
        ({"first": {"size": float("inf")}}, "first.size", "finite_number"),
        ({"first": {"size": 1, "of_python": 3}}, "first.of_python", "unexpected_keyword_argument"),
        ({"first": {"kind": "cloud"}}, "first", "kind"),
        ({"first": {"kind": "stone"}, "others": [{"kind": "stone"}] * 3}, "others", "too_long"),
        ({"first": {"kind": "stone"}, "others": ({"kind": "stone"},)}, "others", "list_type"),
        (3, "", "dataclass_type"),
    ],
)
def test_a_fault_has_its_place(document: object, place: str, fault: str) -> None:
    assert faults(document) == [(place, fault)]


def test_who_reads_may_look_at_every_object() -> None:
    """Those of a type that occurs twice, too."""
    seen: list[str] = []

    class Reader:
        def read(self, document: type[Any], value: Any, inner: Any) -> Any:
            seen.append(document.__name__)
            return inner(value)

    TREES.validate_python({"first": {"size": 1}, "others": [{"size": 1}, {"kind": "stone"}]}, context=Reader())
    assert seen == ["Tree", "Leaf", "Leaf", "Stone"]


def test_a_document_says_what_its_keys_are() -> None:
    assert keys_of(Leaf) == ("kind", "size", "of-json")
    assert required_of(Leaf) == ("size",)
    assert docs_of(Leaf) == {"size": "A number.", "of_python": "Named otherwise."}
    assert types_of(Leaf)["size"] == NUMBER
    schema = TREES.json_schema()
    assert schema["$defs"]["Leaf"]["required"] == ["size"]
    assert schema["$defs"]["Leaf"]["properties"]["of-json"]["description"] == "Named otherwise."
    assert schema["properties"]["first"]["oneOf"] == [{"$ref": "#/$defs/Leaf"}, {"$ref": "#/$defs/Stone"}]
    assert schema["properties"]["others"]["maxItems"] == 2


# The schema and the numerics: a short document, and the same with the defaults of the schema, are one problem.


U, ONE = {"expression": "x*y"}, {"expression": "1"}
AXIS = [k / 63 for k in range(64)]
NODAL = {"nodal": {"x": [[s] * 64 for s in AXIS], "y": [AXIS] * 64, "values": [[s * t for t in AXIS] for s in AXIS]}}
SIDES: dict[str, Any] = {
    "bottom": {"x": "t", "y": "0"},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"x": "t", "y": "1"},
    "left": {"points": [[0, 0], [0, 1]]},
}
SQUARE: dict[str, Any] = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 3]}],
}
ARC: dict[str, Any] = {"kind": "arc_length", "u": U}
# What a kind of monitor or domain needs.
NEEDS: dict[str, dict[str, Any]] = {
    "nodal_solution": {"u": NODAL},
    "weight": {"rho": ONE},
    "tensor": {"m11": ONE, "m12": {"expression": "0"}, "m22": ONE},
    "intersection": {"monitors": [ARC, {"kind": "weight", "rho": ONE}]},
    "quadrilateral": SIDES,
    "blocks": SQUARE,
    "mesh": {"file": "square.json"},
}
DOCUMENTS: dict[str, dict[str, Any]] = {
    "least": {"monitor": {"u": U}},
    **{kind: {"monitor": {"kind": kind, **NEEDS.get(kind, {"u": U})}} for kind in monitors.MONITORS.documents},
    **{
        kind: {"monitor": {"u": U}, "domain": {"kind": kind, **NEEDS.get(kind, {})}}
        for kind in domains.DOMAINS.documents
    },
    **{kind: {"monitor": ARC, "schwarz": {"transmission": {"kind": kind}}} for kind in schwarz.TRANSMISSIONS.documents},
    "target": {"monitor": {"u": U}, "target": {"error": 1}},
    "between blocks": {"monitor": {"u": U}, "domain": {"kind": "blocks", **SQUARE}, "schwarz": {}},
}


def test_a_stored_spec_may_have_null_for_what_its_mesh_is_for() -> None:
    was, said = ({"monitor": {"u": U, "for": purpose}} for purpose in (None, "interpolation"))
    assert read_spec(was).canonical == read_spec(said).canonical
    assert build(was) == build(said)


def find(_: str, settings: Any) -> em.Blocks:
    assert not settings
    return em.Blocks.of(SQUARE)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_and_its_completion_are_one_problem(name: str) -> None:
    short, whole = (build(one, find_mesh=find) for one in (DOCUMENTS[name], read_spec(DOCUMENTS[name]).canonical))
    if isinstance(short.problem.domain, em.Blocks):
        assert isinstance(whole.problem.domain, em.Blocks)
        assert (short.problem.domain.mesh.points == whole.problem.domain.mesh.points).all()
        assert short.schwarz == whole.schwarz
    else:
        assert short == whole


@pytest.mark.parametrize(
    ("words", "known"),
    [
        (mesh.BOUNDARIES, em.Boundary),
        (mesh.INITIALS, em.Initial),
        (mesh.MODES, em.Mode),
        (mesh.CELLS, CELLS),
        (schwarz.ORDERINGS, em.Ordering),
        (schwarz.LOCAL_SOLVERS, em.LocalSolver),
        (schwarz.INTERFACE_DATA, em.LineData),
        (schwarz.ACCELERATIONS, ["auto", *em.Acceleration]),
        (get_args(monitors.Norm), NORMS),
        (get_args(get_type_hints(monitors.Auto)["purpose"]), PURPOSES),
    ],
)
def test_words_are_those_of_the_numerics(words: Words | tuple[Any, ...], known: Any) -> None:
    assert {*words} == {str(word) if isinstance(word, StrEnum) else word for word in known}


def test_the_numerics_have_every_setting() -> None:
    for document, made in (
        (mesh.Target, em.Target),
        (mesh.Grid, em.Grid),
        (schwarz.Schwarz, em.Schwarz),
        (domains.Rectangle, em.Rectangle),
        (domains.AnnulusSector, em.AnnulusSector),
    ):
        elsewhere = {"kind", "points"}  # in Python a number of points of the whole grid is a target
        assert {*keys_of(document)} - elsewhere == {one.name for one in fields(made)}  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", monitors.MONITORS.documents)
def test_the_client_sends_the_monitor_that_was_meant(kind: str) -> None:
    def read(function: object) -> dict[str, Any]:
        return {"nodal": function} if isinstance(function, dict) else {"expression": function}

    needs: dict[str, dict[str, Any]] = {
        "nodal_solution": {"u": NODAL["nodal"]},
        "weight": {"rho": "1"},
        "tensor": {"m11": "1", "m12": "0", "m22": "1"},
        "intersection": {"monitors": [monitors.ArcLength(u="x*y"), monitors.Weight("1")]},
    }
    made: Any = monitors.MONITORS.documents[kind](**needs.get(kind, {"u": "x*y"}))
    assert build({"monitor": monitor_json(made, read, None)}) == build(DOCUMENTS[kind])


def test_functions_are_found_by_their_types() -> None:
    assert FUNCTIONS == ("u", "adjoint", "earlier", "rho", "m11", "m12", "m22")
    assert functions_of(MONITORS.documents["weight"]) == ("rho", "u")
    needing = {kind for kind, names in REQUIRED_FUNCTIONS.items() if names == ("u",)}
    assert needing == {"auto", "least_error", "nodal_solution", "arc_length", "curvature"}
    assert {kind: names for kind, names in REQUIRED_FUNCTIONS.items() if kind not in needing} == {
        "weight": ("rho",),
        "tensor": ("m11", "m12", "m22"),
        "intersection": (),
    }


def test_every_setting_says_what_it_is() -> None:
    for kind, monitor in MONITORS.documents.items():
        assert keys_of(monitor)[0] == "kind"
        assert monitor.USE.endswith(".")
        told = {*docs_of(monitor), "kind", "u"}
        assert told >= {*types_of(monitor)}, kind


@dataclass(frozen=True, kw_only=True)
class Thing(Document):
    kind: Literal["thing"] = "thing"
    u: Function = None
    size: Annotated[float, Shown("Its size", minimum=0.0)] = 2.0
    """How large it is."""
    count: Annotated[int | Literal["auto"], Either("a number, or 'auto'")] = "auto"
    word: Annotated[str, Words("first_one", "other")] = "other"
    bound: float | None = None
    is_on: bool = True
    ends: Pair = (0.0, 1.0)
    inner: Document | None = None
    names: list[str] = field(default_factory=list)


def test_a_setting_is_a_number_a_flag_or_a_word() -> None:
    found = {one.key: one for one in settings_of(Thing)}
    assert list(found) == ["size", "count", "word", "bound", "is_on"]
    assert [one.plain for one in found.values()] == [float, int, None, float, bool]
    assert [one.takes_null for one in found.values()] == [False, False, False, True, False]
    assert found["count"].words == ("auto",)
    assert setting_of(Thing, "u") is setting_of(Thing, "ends") is setting_of(Thing, "inner") is None


def test_a_setting_as_it_is_published() -> None:
    size, _, word, bound, _ = (one.to_json() for one in settings_of(Thing))
    assert size == {
        "name": "size",
        "type": "number",
        "default": 2.0,
        "help": "How large it is.",
        "words": [],
        "title": "Its size",
        "minimum": 0.0,
    }
    assert word["words"] == [{"name": "first_one", "title": "first one"}, {"name": "other", "title": "other"}]
    assert (bound["title"], bound["words"]) == ("Bound", [{"name": None, "title": "none"}])


def test_all_kinds_are_published_with_their_settings() -> None:
    found: Any = json.loads(json.dumps(choices()))
    kinds = {one["name"]: one for one in found["monitors"]}
    assert kinds["weight"]["functions"] == ["rho", "u"]
    assert [kind for kind, one in kinds.items() if one["member"]] == [*MEMBERS.documents]
    for document in (LeastError, Weight):
        shown = [one["name"] for one in kinds[document.kind]["settings"]]
        assert shown == [one.key for one in settings_of(document)]
    assert {one["name"] for one in found["transmissions"]} >= {"optimized", "classical"}


def test_words_are_escaped_and_warnings_are_few() -> None:
    page = html_of("a < b", [("u", "<script>")], [f"warning {k}" for k in range(MAX_WARNINGS + 2)], b"PNG", 'a "mesh"')
    assert "a &lt; b" in page
    assert "<script>" not in page
    assert "warning 2" in page
    assert "warning 3" not in page
    assert "2 more warnings are in the certificate." in page
    assert 'alt="a &quot;mesh&quot;"' in page


def test_no_colour_is_set_so_that_it_is_read_in_light_and_dark() -> None:
    page = html_of("title", [("a", "1"), ("a", "2")])
    assert not re.search(r"colou?r|background", page)
    assert "<img" not in page
    assert page.count("<tr>") == 2
