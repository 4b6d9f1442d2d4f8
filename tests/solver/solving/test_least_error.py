"""Least-error solves: never worse than the uniform mesh, with records, and what goes with them."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.descent import Descent
from equimesh.least_error.nest import nested_levels
from equimesh.quality.interpolation import InterpolationErrors
from equimesh.solving import least_error
from equimesh.solving.solution import Solution

FRONT = em.Expression("tanh(40*(x + y/2 - 0.75))")
GRID = em.Grid(n_xi=25, n_eta=21)


def problem(u: em.Field = FRONT, grid: em.Grid = GRID, **asked: Any) -> em.Problem:
    return em.Problem(monitor=em.LeastError(u=u, **asked), grid=grid)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_solve_gains_and_is_completed(norm: str) -> None:
    solution = em.solve(problem(norm=norm), threads=1)
    errors = solution.interpolation
    assert errors is not None
    assert (errors.gain_l2 if norm == "l2" else errors.gain_h1) > 2.0
    assert min(errors.gain_l2, errors.gain_h1 if norm == "h1" else 1.0) >= 1.0
    assert solution.status is em.Status.COMPLETED
    assert solution.note == ""
    assert not solution.mesh.is_folded
    assert solution.certificate.equation_residual is None


@pytest.mark.parametrize("asked", [{}, {"norm": "h1"}, {"cells": "triangle"}, {"degree": 2}], ids=str)
def test_the_errors_of_a_solve_are_those_of_its_quality_which_is_not_measured_before_it_is_asked_for(
    asked: dict[str, Any],
) -> None:
    solution = em.solve(problem(grid=em.Grid(9, 9), **asked), threads=1)
    errors = solution.interpolation
    assert "quality" not in vars(solution)
    both = replace(solution).quality.interpolation_error, solution.quality.interpolation_error
    for other in both:
        assert errors is not None
        assert other is not None
        assert (other.l2, other.h1, other.gain_l2, other.resolved) == (
            errors.l2,
            errors.h1,
            errors.gain_l2,
            errors.resolved,
        )


def test_sides_are_met_exactly() -> None:
    solution = em.solve(problem(), threads=1)
    x, y = solution.mesh.x, solution.mesh.y
    for side in (x[0], 1 - x[-1], y[:, 0], 1 - y[:, -1]):
        assert (side == 0.0).all()


def test_the_observer_gets_every_step_and_the_solution_keeps_their_numbers() -> None:
    seen: list[Any] = []
    solution = em.solve(problem(), threads=1, observe=seen.append)
    assert all(isinstance(step, Descent) for step in seen)
    assert [step.numbers() for step in seen] == list(solution.descent)
    assert json.loads(json.dumps(solution.convergence()))["descent"] == [step.numbers() for step in seen]
    assert np.array_equal(seen[-1].mesh.x, solution.reference.x)
    assert solution.newton_steps == sum(step.grid == GRID for step in seen) > 0


def test_a_solution_can_be_pickled() -> None:
    solution = em.solve(problem(), threads=1)
    summary = solution.certificate.summary()  # its measures stay behind, and are made anew
    copy = pickle.loads(pickle.dumps(solution))
    assert np.array_equal(copy.mesh.x, solution.mesh.x)
    assert copy.certificate.summary() == summary
    assert copy.descent == solution.descent


def test_the_uniform_mesh_is_the_last_resort(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[Solution] = []

    def never(solution: Solution, norm: str) -> bool:  # noqa: ARG001
        tried.append(solution)
        return False

    monkeypatch.setattr(least_error, "is_no_worse", never)
    u = em.Expression("exp(-x/0.01) + exp(-y/0.01)")  # begins rectilinear, then from the uniform mesh
    solution = em.solve(problem(u), threads=1)
    assert len(tried) == 2
    assert tried[0].mesh.distance(tried[1].mesh) > 1e-6
    assert {record["start"] for record in tried[1].descent[len(tried[0].descent) :]} == {"uniform"}
    assert solution.mesh.distance(em.Mesh.uniform(GRID)) == 0.0
    assert solution.reference.distance(em.Mesh.uniform(GRID)) == 0.0
    assert solution.note == least_error.NO_BETTER.format("uniform")
    assert solution.interpolation is not None
    assert solution.interpolation.gain_l2 == 1.0


def test_the_last_resort_is_a_success_where_all_others_are_folded(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, finish = em.Grid(n_xi=5, n_eta=5), least_error._finish
    monkeypatch.setattr(least_error, "_finish", lambda *given: replace(finish(*given), status=em.Status.FOLDED))
    monkeypatch.setattr(least_error, "is_no_worse", lambda *_: False)
    solution = em.solve(problem(grid=grid), threads=1)
    assert solution.mesh.distance(em.Mesh.uniform(grid)) == 0.0
    assert solution.status is em.Status.COMPLETED


@pytest.mark.parametrize(
    ("l2", "h1", "norm", "kept"),
    [(0.5, 2.0, "l2", True), (0.5, 2.0, "h1", False), (2.0, 0.5, "l2", False), (2.0, 0.5, "h1", False)],
)
def test_both_norms_count_where_the_gradient_is_requested(l2: float, h1: float, norm: str, kept: bool) -> None:
    solution = em.solve(problem(), threads=1)
    errors = InterpolationErrors(l2=l2, l2_uniform=1.0, h1=h1, h1_uniform=1.0)
    vars(solution)["interpolation"] = errors  # in place of the measured ones
    assert least_error.is_no_worse(solution, norm) is kept


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_the_error_of_u_is_tried_where_its_gradient_alone_gains(monkeypatch: pytest.MonkeyPatch, norm: str) -> None:
    tried: list[Solution] = []

    def third(solution: Solution, norm: str) -> bool:  # noqa: ARG001
        tried.append(solution)
        return len(tried) == 3

    monkeypatch.setattr(least_error, "is_no_worse", third)
    layers = problem(em.Expression("exp(-x/0.01) + exp(-y/0.01)"), norm=norm)
    solution = em.solve(layers, threads=1)
    assert len(tried) == (3 if norm == "h1" else 2)
    if norm == "h1":
        monkeypatch.undo()
        values = em.solve(problem(em.Expression("exp(-x/0.01) + exp(-y/0.01)")), threads=1)
        assert solution.mesh.distance(values.mesh) == 0.0
        assert solution.problem == layers


def test_a_steep_front_gains_in_both_norms_where_its_gradient_is_requested() -> None:
    solution = em.solve(problem(em.Expression("tanh(52.4*(x - 0.738))"), em.Grid(n_xi=33, n_eta=33), norm="h1"))
    errors = solution.interpolation
    assert errors is not None
    assert min(errors.gain_l2, errors.gain_h1) > 3.0


def errors_of(solution: Solution, norm: str) -> float:
    errors = solution.interpolation
    assert errors is not None
    return errors.l2 if norm == "l2" else errors.h1


@pytest.mark.parametrize("n", [9, 25, 41])
@pytest.mark.parametrize("norm", ["l2", "h1"])
@pytest.mark.parametrize("u", [FRONT, em.Expression("exp(-x/0.001) + exp(-y/0.001)")], ids=["front", "layers"])
def test_a_given_mesh_is_not_made_worse(u: em.Expression, norm: str, n: int) -> None:
    grid = em.Grid(n_xi=n, n_eta=n)
    best = em.solve(problem(u, grid, norm=norm, distortion=0.1, smoothness=0.05), threads=1)
    again = em.solve(problem(u, grid, norm=norm, distortion=5.0, smoothness=5.0), initial=best.reference, threads=1)
    assert errors_of(again, norm) <= errors_of(best, norm) * (1.0 + 1e-12)


def test_a_given_mesh_of_another_time_is_improved() -> None:
    before = em.solve(problem(em.Expression("tanh(40*(x + y/2 - 0.72))")), threads=1)
    after = em.solve(problem(), initial=before.reference, threads=1)
    fresh = em.solve(problem(), threads=1)
    assert after.interpolation is not None
    assert after.interpolation.gain_l2 > 0.3 * fresh.interpolation.gain_l2 > 4.0  # type: ignore[union-attr]
    assert after.note == ""


def test_a_given_mesh_that_descent_does_not_better_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    best = em.solve(problem(), threads=1)
    monkeypatch.setattr(least_error.LeastErrorSolve, "steps", lambda solve, _start, **_: iter([uniform_record(solve)]))
    again = em.solve(problem(), initial=best.reference, threads=1)
    assert again.note == least_error.GIVEN_IS_KEPT
    assert again.mesh.distance(best.mesh) == 0.0


def uniform_record(solve: least_error.LeastErrorSolve) -> Descent:
    *_, last = solve.coarse(nested_levels(solve.grid)[0])
    return replace(last, mesh=em.Mesh.uniform(solve.grid), grid=solve.grid)


# Elements of higher degree.

PEAK = em.Expression("exp(-1000*((x-0.5)**2+(y-0.5)**2))")
OF_DEGREE: dict[str, dict[str, Any]] = {
    "quadratic": {"degree": 2},
    "cubic": {"degree": 3},
    "quartic": {"degree": 4},
    "quadratic gradient": {"degree": 2, "norm": "h1"},
    "quadratic triangles": {"degree": 2, "cells": "triangle"},
}


@pytest.mark.parametrize("name", OF_DEGREE)
def test_a_mesh_for_a_degree_gains_for_that_degree(name: str) -> None:
    asked, grid = OF_DEGREE[name], em.Grid(n_xi=17, n_eta=17)
    solution = em.solve(problem(PEAK, grid, **asked), threads=1)
    errors = solution.interpolation
    assert errors is not None
    assert errors.degree == asked["degree"]
    assert not solution.mesh.is_folded
    bilinear = em.solve(problem(PEAK, grid, norm=asked.get("norm", "l2"), cells=asked.get("cells", "quad")), threads=1)
    own = next((one for one in bilinear.gains_by_degree if one.degree == asked["degree"]), None)
    norm = asked.get("norm", "l2")
    assert errors.estimated_gain(norm) > (2.0 * getattr(own, norm) if own is not None else 20.0)
    told = {one.degree: (one.l2, one.h1) for one in solution.certificate.gains_by_degree}
    assert told[errors.degree] == (errors.gain_l2, errors.gain_h1)


@pytest.mark.parametrize("degree", [2, 3])
def test_the_mesh_of_a_degree_is_no_worse_than_uniform_where_that_of_degree_1_is(degree: int) -> None:
    wave = em.Expression("sin(6*x)*cos(5*y)")
    (_, second, third) = em.solve(problem(wave, em.Grid(n_xi=33, n_eta=33)), threads=1).gains_by_degree
    assert max(second.l2, third.l2) < 0.5
    errors = em.solve(problem(wave, em.Grid(n_xi=33, n_eta=33), degree=degree), threads=1).interpolation
    assert errors is not None
    assert errors.gain_l2 > 1.2


def test_a_degree_on_blocks_and_on_closed_lines() -> None:
    nodes = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    blocks = em.Blocks.of_mesh(nodes.points, nodes.cells, nodes.sides)
    monitor = em.LeastError(u=PEAK, degree=2)
    on_blocks = em.solve(em.Problem(monitor=monitor, domain=blocks), threads=1)
    assert on_blocks.interpolation is not None
    assert (on_blocks.interpolation.degree, on_blocks.interpolation.gain_l2 > 10.0) == (2, True)
    ring = em.AnnulusSector(radii=(0.5, 1.5), closed=True)
    front = em.LeastError(u=em.Expression("tanh(10*(x + y/2))"), degree=2)
    closed = em.solve(em.Problem(monitor=front, grid=em.Grid(n_xi=9, n_eta=33), domain=ring), threads=1)
    assert closed.interpolation is not None
    assert closed.interpolation.gain_l2 > 2.0


def test_a_given_mesh_is_kept_where_it_is_better_for_the_degree() -> None:
    asked = problem(PEAK, em.Grid(n_xi=17, n_eta=17), degree=2)
    first = em.solve(asked, threads=1)
    again = em.solve(asked, initial=first.reference, threads=1)
    assert first.interpolation is not None
    assert again.interpolation is not None
    assert again.interpolation.l2 <= first.interpolation.l2
