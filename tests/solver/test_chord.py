"""The chord iteration: the mesh of the reference Newton, for a fraction of the work."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh import chord, kernels, single_domain
from equimesh.boundary import sides
from equimesh.equations import Cells


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return max(abs(one.x - other.x).max(), abs(one.y - other.y).max())


@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_mesh_is_that_of_newton(name: str, boundary: em.Boundary) -> None:
    case = problem(name, 49, 41, boundary=boundary, b=0.1)
    *_, fast = single_domain.iterate(case)
    *_, reference = single_domain.iterate(case, chord=False)
    assert fast.converged is reference.converged
    if fast.converged:
        assert distance(fast.mesh, reference.mesh) < 1e-9


def test_it_converges_on_all_functions_with_the_trace_condition() -> None:
    for name in FUNCTIONS:
        *_, last = single_domain.iterate(problem(name, 65))
        assert last.converged
        assert last.residual < chord.TOLERANCE, "the finest level was not solved by chord sweeps to their tolerance"
        assert last.step > 9, "sweeps, not Newton steps"


def test_sweeps_do_not_grow_with_the_number_of_points() -> None:
    counts = {record.grid.n_xi: record.step for record in single_domain.iterate(problem("tanh20", 257))}
    assert counts == {17: 8, 33: 14, 65: 13, 129: 12, 257: 11}


def test_kernel_agrees_with_the_equations() -> None:
    case = problem("ring", 9, 12, b=0.3)
    random = np.random.default_rng(3)
    mesh = em.Mesh.uniform(case.grid)
    mesh = em.Mesh(*(q + 0.01 * random.standard_normal(q.shape) for q in (mesh.x, mesh.y)))
    equations = case.equations()
    window = equations.window(equations.vector(mesh))
    bottom, top, left, right = (2 * flux.value for flux in Cells(window).fluxes)
    xi, eta = np.zeros((8, 12)), np.zeros((9, 11))
    xi[:, :-1] += bottom / 2
    xi[:, 1:] += top / 2
    eta[:-1] += left / 2
    eta[1:] += right / 2
    along_xi, along_eta = np.full((8, 12), np.nan), np.full((9, 11), np.nan)
    monitor = case.monitor
    kernels.squared_lengths(mesh.x, mesh.y, window.u, monitor.a**2, monitor.b, along_xi, along_eta)
    assert along_xi == pytest.approx(xi * case.grid.d_xi**2, rel=1e-12)
    assert along_eta == pytest.approx(eta * case.grid.d_eta**2, rel=1e-12)


def test_one_sweep_solves_the_leading_part() -> None:
    """With a constant metric only the squares are left out of the leading part: the error falls to its square."""
    case = problem("ring", 14, 11, a=0.0)
    uniform, errors = em.Mesh.uniform(case.grid), []
    for size in (1e-2, 1e-3):
        bump = size * np.sin(np.pi * uniform.x) * np.sin(np.pi * uniform.y)
        sweeps = chord.iterate(case, em.Mesh(uniform.x + bump, uniform.y - bump))
        errors.append([distance(next(sweeps).mesh, uniform), distance(next(sweeps).mesh, uniform)])
    assert errors[0][1] < 0.1 * errors[0][0]
    assert errors[1][1] / errors[0][1] < 0.02


def test_smallest_jacobian_is_that_of_the_mesh() -> None:
    mesh = em.solve(problem("paper", 12)).mesh
    scale = 11 * 11
    assert kernels.smallest_jacobian(mesh.x, mesh.y) * scale == pytest.approx(mesh.min_jacobian)
    broken = mesh.x.copy()
    broken[3, 4] = np.nan
    assert np.isnan(kernels.smallest_jacobian(broken, mesh.y))


def test_a_start_far_away_is_a_failure_and_newton_takes_over() -> None:
    case = problem("wave", 33)
    *_, last = chord.iterate(case, em.Mesh.uniform(case.grid))
    assert last.failed
    assert not last.mesh.is_folded
    *_, solved = single_domain.iterate(case)
    assert solved.converged


def test_it_does_not_apply_where_the_sides_need_the_interior() -> None:
    case = problem("paper", 17, boundary=em.Boundary.ORTHOGONAL)
    assert list(chord.iterate(case, em.Mesh.uniform(case.grid))) == []


def test_the_sides_are_those_of_the_mesh() -> None:
    case = problem("tanh20", 33)
    mesh = em.solve(case).mesh
    moved = []
    for (axis, _), side in sides(case.boundary).items():
        solved = side.line((mesh.x, mesh.y)[1 - axis])
        placed = side.place(case.monitor, np.linspace(0, 1, 33))
        assert placed == pytest.approx(solved, abs=1e-12)
        moved.append(abs(solved - np.linspace(0, 1, 33)).max())
    assert max(moved) > 0.1


def test_what_is_not_a_number_is_no_convergence() -> None:
    """One bad value on one line: every comparison with it is false, and must not count as a small deviation."""
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    u = np.zeros((9, 9))
    u[4, 4] = np.nan
    along_xi, along_eta, inverse = np.empty((8, 9)), np.empty((9, 8)), np.empty((4, 9, 9))
    kernels.squared_lengths(mesh.x, mesh.y, u, 0.49, 0.05, along_xi, along_eta)
    kernels.inverse_matrices(mesh.x, mesh.y, u, 0.49, 0.05, inverse)
    assert np.isnan(kernels.move_nodes(mesh.x, mesh.y, along_xi, along_eta, inverse, mesh.x.copy(), mesh.y.copy()))
