"""Newton, GMRES, and direct solvers: convergence, the guard, honest endings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import csc_array

import equimesh as em
from cases import problem
from equimesh.meshes.nested import prolong
from equimesh.numerics import newton
from equimesh.numerics import threads as workers
from equimesh.numerics.newton import dot, gmres, solve_by_sines, solve_lines
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
        equations.residual, equations.jacobian, start, admissible=anywhere, tolerance=1e-10, factorise=newton.superlu
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


SIZE = 12


def system() -> tuple[Array, Array]:
    rng = np.random.default_rng(1)
    return np.eye(SIZE) * 3.0 + rng.standard_normal((SIZE, SIZE)), rng.standard_normal(SIZE)


def same(v: Array) -> Array:
    return v.copy()


def test_it_is_exact_after_as_many_products_as_unknowns() -> None:
    matrix, right = system()
    found = gmres(lambda v: matrix @ v, same, right, tolerance=1e-14, most=SIZE)
    assert found == pytest.approx(np.linalg.solve(matrix, right), rel=1e-10)


def test_every_product_lowers_the_residual_to_its_smallest() -> None:
    matrix, right = system()
    for most in (1, 3, 6):
        found = gmres(lambda v: matrix @ v, same, right, tolerance=0.0, most=most)
        space = np.column_stack([np.linalg.matrix_power(matrix, k) @ right for k in range(most)])
        best, *_ = np.linalg.lstsq(matrix @ space, right, rcond=None)
        smallest = np.linalg.norm(matrix @ space @ best - right)
        assert np.linalg.norm(matrix @ found - right) == pytest.approx(smallest, rel=1e-8)


def test_an_exact_preconditioner_needs_one_product() -> None:
    matrix, right = system()
    products: list[Array] = []

    def apply(v: Array) -> Array:
        products.append(v)
        return np.asarray(matrix @ v)

    found = gmres(apply, lambda v: np.linalg.solve(matrix, v), right, tolerance=1e-10, most=SIZE)
    assert len(products) == 1
    assert matrix @ found == pytest.approx(right, rel=1e-10)


def test_it_ends_at_the_tolerance() -> None:
    matrix, right = system()
    found = gmres(lambda v: matrix @ v, same, right, tolerance=0.1, most=SIZE)
    rest = np.linalg.norm(matrix @ found - right) / np.linalg.norm(right)
    assert 1e-3 < rest <= 0.1


@pytest.mark.parametrize("right", [np.zeros(3), np.array([1.0, np.nan, 0.0])])
def test_without_a_finite_right_side_nothing_changes(right: Array) -> None:
    assert (gmres(same, same, right, tolerance=1e-3, most=3) == 0.0).all()


def test_a_product_that_is_not_finite_ends_it() -> None:
    found = gmres(lambda v: np.full(v.size, np.inf), same, np.ones(3), tolerance=1e-3, most=3)
    assert (found == 0.0).all()


@pytest.mark.parametrize("size", [0, 1, 4, 7])
def test_the_inner_product(size: int) -> None:
    first, second = np.arange(size) + 1.0, 2.0 * np.arange(size)
    assert dot(first, second) == pytest.approx(float(first @ second))


def test_nested_dissection_orders_every_unknown_once() -> None:
    order = newton.elimination_order((13, 37))
    assert sorted(order) == list(range(2 * 13 * 37))
    assert (order[1::2] - order[::2] == 13 * 37).all()


def second_difference(p: Array, axis: int) -> Array:
    padded = np.pad(p, [(1, 1) if k == axis else (0, 0) for k in range(2)])
    return np.diff(padded, 2, axis=axis)


@pytest.mark.parametrize("shape", [(5, 5), (7, 12), (1, 3), (31, 2)])
def test_the_elliptic_equation_is_solved(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    across, right = rng.uniform(0.0, 3.0, shape[0]), rng.standard_normal(shape)
    p = solve_by_sines(2.0, across, right.copy())
    assert 2.0 * second_difference(p, 0) + across[:, None] * second_difference(p, 1) == pytest.approx(right, abs=1e-12)


def test_every_line_by_itself() -> None:
    right = np.random.default_rng(3).standard_normal((9, 4))
    before = right.copy()
    assert 5.0 * second_difference(solve_lines(5.0, right), 0) == pytest.approx(right, abs=1e-12)
    assert (right == before).all(), "the right side is kept"


def test_threads_are_checked() -> None:
    assert workers.thread_count(None) >= 1
    with pytest.raises(em.InputError, match="threads = 0"):
        em.solve(problem("paper", 9), threads=0)
