"""Newton on vectors: quadratic convergence, the guard, and honest endings."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.sparse import csc_array

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps
from equimesh.meshes.nested import nested_grids, prolong
from equimesh.numerics import dissection, newton
from equimesh.numerics.types import Array
from equimesh.single_domain.iteration import iterate


def square(z: Array) -> Array:
    return z**2 - 4.0


def slope(z: Array) -> csc_array:
    return csc_array(np.diag(2 * z))


def anywhere(z: Array) -> bool:
    return bool(np.isfinite(z).all())


def run(start: float, admissible: Callable[[Array], bool] = anywhere) -> list[newton.NewtonStep]:
    return list(newton.newton_iterations(square, slope, np.array([start]), admissible=admissible, tolerance=1e-12))


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


def test_the_guard_is_what_keeps_the_mesh_unfolded() -> None:
    """Without the demand for positive Jacobians, Newton converges to a folded root of the same equations."""
    case = problem("wave", 17, a=0.9)
    equations, start = case.equations(), em.Mesh.uniform(case.grid)
    folded = []
    for record in newton.newton_iterations(
        equations.residual, equations.jacobian, equations.vector(start), admissible=anywhere, tolerance=1e-9
    ):
        folded.append(equations.mesh(record.z).is_folded)
        if record.step == 60:
            break
    assert any(folded)
    assert not any(solution.mesh.is_folded for solution in newton_steps(equations, start, most_steps=20))


def test_newton_steps_of_the_nested_iteration() -> None:
    """Counts for tanh20: each level starts from the coarser mesh and needs fewer steps."""
    last = {record.grid.n_xi: record for record in iterate(problem("tanh20", 65), sweeps=False)}
    assert [last[n].step for n in (17, 33, 65)] == [8, 4, 4]
    assert all(record.converged for record in last.values())
    assert all(0.40 < record.mesh.min_jacobian < 0.42 for record in last.values())


def test_nested_grids_halve_and_keep_small_directions() -> None:
    assert [grid.shape for grid in nested_grids(em.Grid(n_xi=65, n_eta=65))] == [(17, 17), (33, 33), (65, 65)]
    uneven = nested_grids(em.Grid(n_xi=70, n_eta=6))
    assert [grid.shape for grid in uneven] == [(10, 6), (19, 6), (36, 6), (70, 6)]


def test_a_factorisation_is_kept_while_it_serves() -> None:
    """The same mesh with fewer factorisations than steps, in an order that keeps the factors sparse."""
    case = problem("tanh20", 33)
    made: list[int] = []

    def factorise(matrix: csc_array) -> newton.Solver:
        made.append(matrix.nnz)
        return dissection.factorise(matrix, (33, 33))

    equations = case.equations()
    coarse = list(iterate(problem("tanh20", 17)))[-1].mesh
    start = equations.vector(prolong(coarse, case.grid))
    *_, plain = newton.newton_iterations(
        equations.residual, equations.jacobian, start, admissible=anywhere, tolerance=1e-10
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


def test_nested_dissection_orders_every_unknown_once() -> None:
    order = dissection.elimination_order((13, 37))
    assert sorted(order) == list(range(2 * 13 * 37))
    assert (order[1::2] - order[::2] == 13 * 37).all()


def test_prolongation_is_exact_for_cubics_and_never_folds() -> None:
    grid, fine = em.Grid(n_xi=9, n_eta=7), em.Grid(n_xi=17, n_eta=13)
    uniform, finer = em.Mesh.uniform(grid), em.Mesh.uniform(fine)

    def curved(mesh: em.Mesh) -> em.Mesh:
        return em.Mesh(mesh.x + 0.5 * mesh.x * (1 - mesh.x) * mesh.y, mesh.y + 0.3 * mesh.y**2 * (1 - mesh.y))

    assert abs(prolong(curved(uniform), fine).x - curved(finer).x).max() < 1e-14
    assert abs(prolong(curved(uniform), fine).y - curved(finer).y).max() < 1e-14
