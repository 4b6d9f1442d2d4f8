"""Whole documents, and files that hold them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh import (
    AnnulusSector,
    ArcLength,
    Blocks,
    Boundary,
    Classical,
    Curve,
    Domain,
    Expression,
    Grid,
    Initial,
    InputError,
    LeastError,
    LinearRobin,
    Mesh,
    Mode,
    NodalField,
    NonlinearRobin,
    Optimized,
    Problem,
    Quadrilateral,
    Rectangle,
    Schwarz,
    Target,
    TransmissionCondition,
    adapt_round,
    solve,
    solve_to,
)
from equimesh.specs import BuiltSpec, build, build_domain, build_schwarz, count_points, load
from equimesh.specs.spec import NOT_WITH_BLOCKS
from equimesh.upload.nodal import block_nodes
from refusals import REFUSALS

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


@pytest.mark.parametrize(("part", "name"), [(part, name) for part in REFUSALS for name in REFUSALS[part]])
def test_what_a_service_refuses_is_refused_with_the_same_path(part: str, name: str) -> None:
    document, pointer, *_ = REFUSALS[part][name]
    with pytest.raises(InputError) as caught:
        build(document)
    path = re.sub(r"\[(\d+)\]", r".\1", caught.value.field)
    # Of a number in a list, the solver names the list.
    assert re.sub(r"(\.\d+)+$", "", path) == re.sub(r"(\.\d+)+$", "", pointer[1:].replace("/", "."))


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


# Domains and grids of a document.


SEAM = {"x": "0", "y": "1 + t"}
O_GRID: dict[str, Any] = {
    "bottom": {"x": "sin(2*pi*t)", "y": "cos(2*pi*t)"},
    "right": SEAM,
    "top": {"x": "2*sin(2*pi*t)", "y": "2*cos(2*pi*t)"},
    "left": SEAM,
    "closed": True,
}
SIDES: dict[str, Any] = {
    "bottom": {"x": "t", "y": "h*sin(pi*t)", "parameters": {"h": 0.2}},
    "right": {"points": [[1, 0], [1, 1]]},
    "top": {"points": [[0, 1], [1, 1]]},
    "left": {"x": "0", "y": "t"},
}


@pytest.mark.parametrize(
    ("document", "domain"),
    [
        ({}, Rectangle()),
        ({"kind": "rectangle", "x": [0, 2]}, Rectangle(x=(0, 2))),
        ({"kind": "annulus_sector"}, AnnulusSector()),
        (
            {"kind": "annulus_sector", "center": [1, 0], "radii": [1, 3], "angles": [0, 45]},
            AnnulusSector(center=(1, 0), radii=(1, 3), angles=(0, 45)),
        ),
        (
            {"kind": "quadrilateral", **SIDES},
            Quadrilateral(
                bottom=Curve.of_expressions("t", "h*sin(pi*t)", {"h": 0.2}),
                right=Curve.through([[1, 0], [1, 1]]),
                top=Curve.through([[0, 1], [1, 1]]),
                left=Curve.of_expressions("0", "t"),
            ),
        ),
        (
            {"kind": "quadrilateral", **O_GRID},
            Quadrilateral(
                bottom=Curve.of_expressions("sin(2*pi*t)", "cos(2*pi*t)"),
                right=Curve.of_expressions("0", "1 + t"),
                top=Curve.of_expressions("2*sin(2*pi*t)", "2*cos(2*pi*t)"),
                left=Curve.of_expressions("0", "1 + t"),
                closed=True,
            ),
        ),
    ],
)
def test_every_domain_is_built(document: dict[str, Any], domain: Domain) -> None:
    assert build_domain(document) == domain


BLOCKS: dict[str, Any] = {
    "vertices": {"a": [0, 0], "b": [1, 0], "c": [1, 1], "d": [0, 1]},
    "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 3]}],
}


def test_blocks_are_counted_before_they_are_made() -> None:
    domain = build_domain({"kind": "blocks", **BLOCKS, "refine": 2})
    assert isinstance(domain, Blocks)
    assert domain.points == count_points({**BLOCKS, "refine": 2}) == 9 * 7
    with pytest.raises(InputError, match="possible") as caught:
        count_points({**BLOCKS, "refine": 1e8})
    assert caught.value.field == "domain.blocks"


def test_files_of_meshes_and_of_points_are_beside_a_problem_file(tmp_path: Path) -> None:
    (tmp_path / "square.json").write_text(json.dumps(BLOCKS))
    (tmp_path / "c.csv").write_text("x, y\n0, 0\n0.5, -0.2\n1, 0\n")
    monitor = {"kind": "least_error", "u": "tanh(9*(x - y))"}
    on_curve = {**BLOCKS, "curves": {"c": {"points": "c.csv"}}, "edges": [{"from": "a", "to": "b", "on": "c"}]}
    for domain, points in (({"kind": "mesh", "file": "square.json"}, 20), ({"kind": "blocks", **on_curve}, 20)):
        (tmp_path / "problem.json").write_text(json.dumps({"monitor": monitor, "domain": domain}))
        built = load(tmp_path / "problem.json")
        assert built.problem.domain.points == points  # type: ignore[union-attr]
        with pytest.raises(InputError, match="four sides"):
            assert built.grid_problem
    with pytest.raises(InputError, match="there is no mesh file named") as caught:
        build_domain({"kind": "mesh", "file": "none.msh"})
    assert caught.value.field == "domain.file"


def test_what_goes_with_a_grid_is_refused_on_blocks() -> None:
    document: dict[str, Any] = {"monitor": {"kind": "least_error", "u": "x*y"}, "domain": {"kind": "blocks", **BLOCKS}}
    for name, value in {"grid": {"n_xi": 8}, "boundary": "orthogonal", "parts": 2}.items():
        with pytest.raises(InputError) as caught:
            build({**document, name: value})
        assert caught.value.field == name
        assert caught.value.message == NOT_WITH_BLOCKS[name]
    with pytest.raises(InputError, match="LeastError"):
        build({**document, "monitor": {"kind": "curvature", "u": "x*y"}})


def test_a_budget_of_blocks_is_that_of_a_target() -> None:
    blocks = {**BLOCKS, "refine": 2}
    document = {"monitor": {"kind": "least_error", "u": "tanh(9*y)"}, "domain": {"kind": "blocks", **blocks}}
    found = build({**document, "grid": {"points": 200}}).solve(threads=1)
    monitor = LeastError(u=Expression("tanh(9*y)"))
    expected = solve_to(Target(max_points=200), monitor=monitor, domain=Blocks.of(blocks), threads=1)
    assert np.array_equal(found.mesh.points, expected.mesh.points)
    (shape,) = (block.shape for block in found.mesh.blocks)
    assert 150 < shape[0] * shape[1] <= 200
    assert shape[1] > 2 * shape[0]


def test_the_round_of_a_document_keeps_or_chooses_the_cells_of_its_values() -> None:
    blocks = Blocks.of({**BLOCKS, "refine": 4})
    mesh = blocks.with_counts(np.array([10, 14])).mesh
    values = np.tanh(4 * mesh.y - 2)
    (shape,) = (block.shape for block in mesh.blocks)
    cells = {"block_cells": [[n - 1 for n in shape]]}
    given = {"nodes": mesh.points.tolist(), "values": values.tolist(), **cells}
    monitor = {"kind": "nodal_solution", "u": {"block_nodes": given}}
    document = {"monitor": monitor, "domain": {"kind": "blocks", **BLOCKS, "refine": 4}}
    kept = build(document).solve(threads=1).mesh
    assert np.array_equal(kept.cells, mesh.cells)
    assert np.array_equal(kept.points, adapt_round(mesh, values, blocks.with_counts_of(mesh)).mesh.points)
    solution = build({**document, "grid": {"points": 150}}).solve(threads=1)
    expected = adapt_round(mesh, values, blocks.with_counts_of(mesh), points=150).mesh
    assert np.array_equal(solution.mesh.points, expected.points)
    assert 120 < len(expected.points) <= 150
    assert solution.estimate is not None
    assert solution.certificate.min_jacobian > 0.0
    folder_of = {**monitor, "u": {"samples": "u"}}
    field = block_nodes(**given)
    stored = build({**document, "monitor": folder_of}, lambda *_: field)
    assert np.array_equal(stored.solve(threads=1).mesh.points, kept.points)


def test_the_round_of_a_document_chooses_the_grid() -> None:
    mesh = Mesh.uniform(Grid(n_xi=15, n_eta=15))
    values = np.tanh(3 * mesh.x)
    nodal = {"x": mesh.x.tolist(), "y": mesh.y.tolist(), "values": values.tolist()}
    document = {"monitor": {"kind": "nodal_solution", "u": {"nodal": nodal}}, "grid": {"points": 200}}
    solution = build(document).solve(threads=1)
    expected = adapt_round(mesh, values, points=200).mesh
    assert np.array_equal(solution.mesh.x, expected.x)
    assert solution.problem.grid == expected.grid
    assert expected.grid.n_xi > 2 * expected.grid.n_eta


def test_schwarz_between_blocks() -> None:
    blocks = {**BLOCKS, "blocks": [{**BLOCKS["blocks"][0], "name": "one"}]}
    document: dict[str, Any] = {"monitor": {"kind": "least_error", "u": "x*y"}, "domain": {"kind": "blocks", **blocks}}
    assert build({**document, "schwarz": {}}).schwarz == Schwarz()
    built = build({**document, "schwarz": {"overlap": 2, "groups": [["one"]]}})
    assert (built.schwarz, built.grid_schwarz) == (Schwarz(overlap=2, groups=[["one"]]), None)
    for settings, field in (
        ({"overlap": 0}, "schwarz.overlap"),
        ({"subdomains": [2, 2]}, "schwarz.subdomains"),
        ({"groups": [["two"]]}, "schwarz.groups[0]"),
        (3, "schwarz"),
    ):
        with pytest.raises(InputError) as caught:
            build({**document, "schwarz": settings})
        assert caught.value.field == field


def test_closed_lines() -> None:
    assert build_domain({"periodic": "y"}) == Rectangle(periodic="y")
    assert build_domain({"kind": "annulus_sector", "closed": True}) == AnnulusSector(closed=True)


# Schwarz settings of a document.


def test_a_document_without_settings_is_of_a_single_domain() -> None:
    assert build_schwarz({}) is None
    assert build_schwarz({"schwarz": None, "grid": {"n_xi": 5}}) is None
    assert build_schwarz({"schwarz": {}}) == Schwarz()
    assert build_schwarz({"schwarz": {"subdomains": [[24, 40], 1]}}) == Schwarz(subdomains=((24, 40), 1))


@pytest.mark.parametrize(
    ("document", "condition"),
    [
        ({"kind": "optimized", "data": "local"}, Optimized(data="local")),  # type: ignore[arg-type]
        ({"kind": "classical"}, Classical()),
        ({"kind": "linear_robin"}, LinearRobin()),
        ({"kind": "linear_robin", "p": 2}, LinearRobin(p=2.0)),
        ({"kind": "nonlinear_robin", "p": "auto"}, NonlinearRobin()),
    ],
)
def test_every_condition_is_built(document: dict[str, Any], condition: TransmissionCondition) -> None:
    schwarz = build_schwarz({"schwarz": {"transmission": document, "subdomains": [3, 2], "tolerance": None}})
    assert schwarz == Schwarz(transmission=condition, subdomains=(3, 2), tolerance=None)


def test_settings_are_refused_before_the_grid_is_read() -> None:
    with pytest.raises(InputError) as caught:
        build_schwarz({"grid": {"n_xi": 3}, "schwarz": {"line_correction": 12}})
    assert caught.value.field == "schwarz.line_correction"
    assert build_schwarz({"grid": {"n_xi": 3}}) is None


@pytest.mark.parametrize("kind", ["least_error", "auto", "arc_length"])
def test_every_monitor_has_settings_of_its_own(kind: str) -> None:
    document = {"monitor": {"kind": kind, "u": "x"}}
    given = {"max_exchanges": 3} if kind == "least_error" else {"max_iterations": 3}
    other = {"max_iterations": 3} if kind == "least_error" else {"max_exchanges": 3}
    assert build_schwarz({**document, "schwarz": given}) == Schwarz(**given)
    with pytest.raises(InputError, match="leave it out") as caught:
        build_schwarz({**document, "schwarz": other})
    assert caught.value.field == f"schwarz.{next(iter(other))}"
