"""Newton on vectors: quadratic convergence, the guard, honest endings, and factorisations that are kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import csc_array

from cases import problem
from equimesh.meshes.nested import prolong
from equimesh.numerics import newton
from equimesh.numerics.types import Array
from equimesh.single_domain.iteration import single_domain_steps


def square(z: Array) -> Array:
    return z**2 - 4.0


def slope(z: Array) -> csc_array:
    return csc_array(np.diag(2 * z))


def anywhere(z: Array) -> bool:
    return bool(np.isfinite(z).all())


def run(start: float, admissible: Callable[[Array], bool] = anywhere) -> list[newton.NewtonStep]:
    steps = newton.newton_iterations(
        square, slope, np.array([start]), admissible=admissible, tolerance=1e-12, factorise=newton.superlu
    )
    return list(steps)


def test_quadratic_convergence() -> None:
    errors = [abs(step.z[0] - 2.0) for step in run(3.0)]
    assert len(errors) == 6
    assert errors[2] == pytest.approx(errors[1] ** 2 / 4, rel=0.1)
    assert errors[-1] < 1e-12


def test_a_start_at_the_solution_takes_no_step() -> None:
    (only,) = run(2.0)
    assert (only.step, only.residual) == (0, 0.0)


def test_the_guard_keeps_to_its_side() -> None:
    """From 0.1 a full step goes to 20; a guard that forbids it must still reach the root."""
    steps = run(0.1, lambda z: 0 < z[0] < 5)
    assert max(step.z[0] for step in steps) < 5
    assert min(step.damping for step in steps) < 1
    assert steps[-1].z[0] == pytest.approx(2.0)


def test_no_admissible_step_is_a_stall() -> None:
    (only,) = run(1.0, lambda z: z[0] <= 1.0)
    assert only.stalled


def test_a_singular_matrix_is_a_stall() -> None:
    last = run(0.0)[-1]
    assert last.stalled
    assert last.residual == 4.0


def test_a_factorisation_is_kept_while_it_serves() -> None:
    """The same mesh with fewer factorisations than steps, in an order that keeps the factors sparse."""
    case = problem("tanh20", 33)
    made: list[int] = []

    def factorise(matrix: csc_array) -> newton.Solver:
        made.append(matrix.nnz)
        return newton.factorise(matrix, (33, 33))

    equations = case.equations()
    coarse = list(single_domain_steps(problem("tanh20", 17)))[-1].mesh
    start = equations.vector(prolong(coarse, case.grid))
    *_, plain = newton.newton_iterations(
        equations.residual,
        equations.jacobian,
        start,
        admissible=anywhere,
        tolerance=1e-10,
        factorise=newton.superlu,
    )
    *_, kept = newton.newton_iterations(
        equations.residual,
        equations.jacobian,
        start,
        admissible=anywhere,
        tolerance=1e-10,
        factorise=factorise,
        reuse=True,
    )
    assert abs(kept.z - plain.z).max() < 1e-11
    assert len(made) < kept.step
    assert len(made) <= plain.step
