"""The objective of a solver's error: its value is that of the Ritz projection, and its gradient is exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.least_error.kernels import Rule, Values
from equimesh.least_error.objective import Objective
from equimesh.least_error.other_errors import ProjectedObjective
from equimesh.least_error.projection import are_finite, is_projected, unknowns_of
from equimesh.least_error.starts import mesh_of
from equimesh.numerics.types import Array
from equimesh.quality.ritz import coarsened, ritz_errors

U = em.Expression("tanh(8*(x - y*y))")
N = 9


def solve_of(domain: em.Domain, **more: Any) -> LeastErrorSolve:
    monitor = em.LeastError(u=U, purpose="finite_element", **more).on(domain)
    return LeastErrorSolve(monitor=monitor, domain=domain, grid=em.Grid(n_xi=N, n_eta=N))


def objective_of(solve: LeastErrorSolve) -> tuple[Objective, Array, Array]:
    """The objective on the finest grid, a mesh near the uniform one, and a direction in which its nodes may move."""
    level, first = solve.levels[-1], solve.nest.uniform()
    objective = solve._objective(level, first, solve.monitor.norm)
    move = np.zeros((2, N, N))
    move[:, 1:-1, 1:-1] = np.random.default_rng(3).normal(size=(2, N - 2, N - 2))
    direction = move.reshape(2, -1)
    return objective, solve.nest.initial(level) + 3e-3 * direction, direction


@pytest.mark.parametrize(
    ("domain", "more"),
    [
        (em.Rectangle(), {}),
        (em.Rectangle(), {"cells": "triangle"}),
        (em.AnnulusSector(closed=True), {}),
        (em.Rectangle(), {"obliqueness": 5.0}),
    ],
    ids=["square", "triangles", "ring", "oblique"],
)
def test_the_gradient_is_that_of_the_value(domain: Any, more: dict[str, Any]) -> None:
    objective, mesh, direction = objective_of(solve_of(domain, **more))
    assert isinstance(objective, ProjectedObjective)
    here, step = objective.evaluate(mesh), 1e-6
    ahead, behind = (objective.evaluate(mesh + sign * step * direction) for sign in (1.0, -1.0))
    slope = float(np.sum(here.gradient * direction))
    assert slope == pytest.approx((ahead.value - behind.value) / (2.0 * step), rel=1e-5)


def test_the_error_is_that_of_the_ritz_projection() -> None:
    solve = solve_of(em.Rectangle())
    level, first = solve.levels[-1], solve.nest.uniform()
    weights, chart, cells = solve._objective(level, first, "l2").weights, solve.nest.chart(level), cells_of_grid((N, N))
    start = solve.nest.initial(level)
    objective = ProjectedObjective(U, chart, cells, start, weights, Rule(points=3))
    _, mesh, _ = objective_of(solve)
    there = ritz_errors(coarsened(mesh_of(mesh, em.Grid(n_xi=N, n_eta=N))), U)
    assert objective.error(mesh) == pytest.approx(there.l2, rel=1e-10)


def test_in_the_norm_of_the_gradient_and_on_fine_grids_the_error_is_that_of_interpolation() -> None:
    solve = solve_of(em.Rectangle(), norm="h1")
    assert type(solve._objective(solve.levels[-1], solve.nest.uniform(), "h1")) is Objective
    assert is_projected(cells_of_grid((65, 65)))
    assert is_projected(cells_of_grid((513, 9)))
    assert not is_projected(cells_of_grid((129, 129)))
    assert not is_projected(cells_of_grid((2, 5)))  # all nodes are on the boundary


@pytest.mark.parametrize("closed", [(False, False), (True, False), (True, True)])
def test_neighbours_have_near_numbers(closed: tuple[bool, bool]) -> None:
    number, count, width = unknowns_of(cells_of_grid((12, 9), closed))
    inside = {(False, False): 10 * 7, (True, False): 11 * 7, (True, True): 11 * 8 - 1}[closed]
    assert count == inside == number.max() + 1
    assert width <= 30


def test_a_free_descent_gains_for_a_solver_and_obliqueness_bounds_angles() -> None:
    u = em.Expression("tanh(20*(x + y/2 - 0.75))")
    plain, free, moderate = (
        em.solve(em.Problem(monitor=em.LeastError(u=u, **more), grid=em.Grid(n_xi=17, n_eta=17)), threads=1)
        for more in ({}, {"purpose": "finite_element"}, {"purpose": "finite_element", "obliqueness": 20.0})
    )
    gains = [one.solver_gain.l2 for one in (plain, moderate, free) if one.solver_gain is not None]
    assert gains[0] < gains[1] < gains[2]
    assert free.faces.non_orthogonality > moderate.faces.non_orthogonality + 5.0


@pytest.mark.parametrize("value", [-1.0, 1e4, float("nan"), "much", True])
def test_a_weight_that_is_none_is_refused(value: Any) -> None:
    with pytest.raises(em.InputError, match="30 is usual") as caught:
        em.LeastError(u=U, obliqueness=value)
    assert caught.value.field == "obliqueness"


def test_subdomains_have_no_solvers_error() -> None:
    problem = em.Problem(monitor=em.LeastError(u=U, purpose="finite_element"), grid=em.Grid(n_xi=9, n_eta=9))
    with pytest.raises(em.InputError, match="leave the purpose or the Schwarz settings out"):
        em.solve(problem, em.Schwarz(subdomains=(2, 1)))


def test_blocks_descend_on_a_solvers_error_too() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    blocks = em.Blocks.of_mesh(mesh.points, mesh.cells, mesh.sides)
    gains = []
    for purpose in ("interpolation", "finite_element"):
        monitor = em.LeastError(u=em.Expression("tanh(20*(x + y/2 - 0.75))"), purpose=purpose)  # type: ignore[arg-type]
        found = em.solve(em.Problem(monitor=monitor, domain=blocks), threads=1).solver_gain
        gains.append(found.l2)
    assert gains[1] > 1.2 * gains[0]


@pytest.mark.parametrize("part", range(6))
def test_a_number_that_is_not_finite_is_found_in_every_derivative(part: int) -> None:
    values = Values(*np.ones((6, 4, 5)))
    assert are_finite(values)
    values[part][2, 3] = np.nan if part % 2 else np.inf
    assert not are_finite(values)
