"""Whole documents, and files that hold them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh import (
    AnnulusSector,
    ArcLength,
    Boundary,
    Expression,
    Grid,
    Initial,
    InputError,
    Mode,
    NodalField,
    Problem,
    Schwarz,
    solve,
)
from equimesh.specs import BuiltSpec, build, load

U = {"expression": "tanh(5*(x - y))"}
SPEC: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": U, "a": 0.5},
    "domain": {"kind": "annulus_sector"},
    "grid": {"n_xi": 9, "n_eta": 12},
    "boundary": "orthogonal",
    "initial": "uniform",
    "schwarz": {"subdomains": [1, 2], "overlap": 2},
    "mode": "tight",
    "allow_relaxed": False,
    "cells": "triangle",
    "label": "a ring",
}


def test_a_document_becomes_the_arguments_of_a_solve() -> None:
    problem = Problem(
        monitor=ArcLength(u=Expression("tanh(5*(x - y))"), a=0.5),
        grid=Grid(n_xi=9, n_eta=12),
        boundary=Boundary.ORTHOGONAL,
        domain=AnnulusSector(),
    )
    built = build(SPEC)
    assert built == BuiltSpec(
        problem=problem,
        target=None,
        schwarz=Schwarz(subdomains=(1, 2), overlap=2),
        initial=Initial.UNIFORM,
        mode=Mode.TIGHT,
        allow_relaxed=False,
        cells="triangle",
        label="a ring",
    )
    mesh = solve(built.problem, built.schwarz, initial=built.initial).mesh
    assert np.array_equal(mesh.x, solve(problem, built.schwarz, initial=Initial.UNIFORM).mesh.x)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"monitr": {}}, "monitr"),
        ({"monitor": None}, "monitor"),
        ({"domain": None}, "domain"),
        ({"grid": {"n_xi": 3}}, "grid.n_xi"),
        ({"grid": {"n_eta": 8.5}}, "grid.n_eta"),
        ({"grid": []}, "grid"),
        ({"boundary": "fixed"}, "boundary"),
        ({"initial": None}, "initial"),
        ({"mode": "fast"}, "mode"),
        ({"allow_relaxed": "no"}, "allow_relaxed"),
        ({"cells": "hexagon"}, "cells"),
        ({"label": 3}, "label"),
        ({"schwarz": {"overlap": 99}}, "schwarz.overlap"),
    ],
)
def test_a_fault_has_the_path_of_the_document(change: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError) as caught:
        build({**SPEC, **change})
    assert caught.value.field == field


def test_a_document_is_an_object_with_a_monitor() -> None:
    for document, field in (({}, "monitor"), ([], "")):
        with pytest.raises(InputError) as caught:
            build(document)  # type: ignore[arg-type]
        assert caught.value.field == field


def test_samples_are_found_by_their_names() -> None:
    asked = []
    mesh = solve(build({"monitor": {"kind": "arc_length", "u": U}, "grid": {"n_xi": 8, "n_eta": 8}}).problem).mesh
    nodal = NodalField(mesh=mesh, values=mesh.x)

    def find(name: str, box: object) -> NodalField:
        asked.append((name, box))
        return nodal

    built = build({"monitor": {"kind": "arc_length", "u": {"samples": "mine"}}, "domain": {"x": [0, 1]}}, find)
    assert built.problem.monitor == ArcLength(u=nodal)
    assert asked == [("mine", ((0.0, 1.0), (0.0, 1.0)))]


def test_a_problem_file_is_loaded_with_the_samples_next_to_it(tmp_path: Path) -> None:
    file = tmp_path / "problem.json"
    file.write_text(json.dumps(SPEC))
    assert load(file) == load(str(file)) == build(SPEC)
    (tmp_path / "u.csv").write_text("x,y,u\n0,0,0\n0,1,1\n1,0,2\n1,1,4\n")
    file.write_text(json.dumps({"monitor": {"kind": "arc_length", "u": {"samples": "u.csv"}}}))
    assert load(file).problem.monitor.u.evaluate(np.ones(1), np.ones(1))[0] == pytest.approx(4.0)  # type: ignore[union-attr]
    file.write_text('{"monitor": ')
    with pytest.raises(InputError, match="is not JSON"):
        load(file)
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.json")
