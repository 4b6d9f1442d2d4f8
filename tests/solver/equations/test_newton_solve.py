"""Guarded Newton solves of mesh equations."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps, smallest_move, smallest_residual, smallest_tolerance
from equimesh.numerics import newton


def test_the_guard_is_what_keeps_the_mesh_unfolded() -> None:
    """Without the demand for positive Jacobians, Newton converges to a folded root of the same equations."""
    case = problem("wave", 17, a=0.9)
    equations, start = case.equations(), em.Mesh.uniform(case.grid)
    folded = []
    for record in newton.newton_iterations(
        equations.residual,
        equations.jacobian,
        equations.vector(start),
        admissible=lambda z: bool(np.isfinite(z).all()),
        tolerance=1e-9,
        factorise=newton.superlu,
    ):
        folded.append(equations.mesh(record.z).is_folded)
        if record.step == 60:
            break
    assert any(folded)
    assert not any(solution.mesh.is_folded for solution in newton_steps(equations, start, most_steps=20))


# What rounding leaves: in proportion to the points, and to how much larger u is than its variation.


def case(points: int, offset: float = 0.0) -> em.Problem:
    u = em.Expression("c + x", parameters={"c": offset})
    return em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=points, n_eta=9))


def test_rounding_grows_with_the_points_of_the_longer_direction() -> None:
    assert smallest_tolerance(case(20)) == pytest.approx(2e-12)
    assert smallest_tolerance(case(200)) == pytest.approx(2e-11)
    assert smallest_move((20, 300)) == pytest.approx(3e-13)
    metric = case(20).metric
    assert smallest_residual(metric, (40, 20)) == pytest.approx(2 * smallest_residual(metric, (20, 20)))


def test_rounding_grows_with_what_is_lost_in_differences_of_u() -> None:
    near, far = case(20), case(20, 1e5 - 1)
    assert smallest_tolerance(far) == pytest.approx(2e-12 + 20 * 1e-14 * (1e5 - 1))
    assert smallest_residual(far.metric, (20, 9)) == pytest.approx(1e5 * smallest_residual(near.metric, (20, 9)))


def test_a_tight_solve_ends_above_what_rounding_leaves() -> None:
    solution = em.solve(problem("paper", 24), mode=em.Mode.TIGHT)
    assert solution.residual > smallest_residual(problem("paper", 24).metric, (24, 24))
