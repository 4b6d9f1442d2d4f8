"""The schema and the numerics: a short document, and the same with the defaults of the schema, are one problem."""

from __future__ import annotations

from dataclasses import fields
from enum import StrEnum
from typing import Any, get_args, get_type_hints

import pytest

import equimesh as em
from equimesh.io.write import CELLS
from equimesh.monitors.auto import PURPOSES
from equimesh.monitors.curvature import NORMS
from equimesh.specs import build
from equimesh_client.spec.request import monitor_json
from equimesh_schema import domains, mesh, monitors, schwarz
from equimesh_schema.document import Words, keys_of
from equimesh_service.spec.mesh import read_spec

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


def find(_: str, settings: Any) -> em.Blocks:
    assert not settings
    return em.Blocks.of(SQUARE)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_and_its_completion_are_one_problem(name: str) -> None:
    short, whole = (build(one, find_mesh=find) for one in (DOCUMENTS[name], read_spec(DOCUMENTS[name]).canonical))
    if isinstance(short.problem, em.BlockProblem):
        assert isinstance(whole.problem, em.BlockProblem)
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
        (get_args(get_args(get_type_hints(monitors.Auto)["purpose"])[0]), PURPOSES),
    ],
)
def test_words_are_those_of_the_numerics(words: Words | tuple[Any, ...], known: Any) -> None:
    assert {*words} == {str(word) if isinstance(word, StrEnum) else word for word in known}


def test_the_numerics_have_every_setting() -> None:
    for document, made in (
        (schwarz.Schwarz, em.Schwarz),
        (schwarz.BlockSchwarz, em.BlockSchwarz),
        (mesh.Target, em.Target),
        (mesh.Grid, em.Grid),
        (domains.Rectangle, em.Rectangle),
        (domains.AnnulusSector, em.AnnulusSector),
    ):
        assert {*keys_of(document)} - {"kind"} == {one.name for one in fields(made)}  # type: ignore[arg-type]


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
