"""What happens where the equations have no solution near the start: weaker ones, as near as can be, and said so."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps
from equimesh.numerics.newton import newton_iterations
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import CROSS_LINE_WEIGHTS, Interior, Relaxation, scale
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.single_domain.level import Step, interpolated_level
from equimesh.single_domain.solved_sides import with_solved_sides


def two_peaks(points: int, **settings: float) -> em.Problem:
    u = em.Expression("exp(-80*((x - 0.3)**2 + (y - 0.3)**2)) + exp(-80*((x - 0.7)**2 + (y - 0.7)**2))")
    return em.Problem(monitor=em.ArcLength(u=u, **settings, scaled=False), grid=em.Grid(n_xi=points, n_eta=points))


def test_the_cross_line_term_gives_a_mesh_where_there_was_none() -> None:
    solution = em.solve(two_peaks(33))
    assert solution.status is em.Status.RELAXED
    (what,) = solution.relaxed
    assert (what.what, what.asked) == ("cross_line", 0.0)
    assert what.reached in CROSS_LINE_WEIGHTS[1:4]
    assert solution.mesh.min_jacobian > 0.1
    assert solution.certificate.equation_residual > 0.01, "the asked equations are not satisfied, and that is measured"
    (warning,) = (w for w in solution.certificate.warnings if "not the requested ones" in w)
    assert "cross-line" in warning


def test_the_mesh_satisfies_the_relaxed_equations() -> None:
    case = two_peaks(33)
    *_, last = single_domain_steps(case)
    assert last.converged
    equations = case.equations(last.relaxation.cross_line * scale(case))
    z = equations.vector(last.mesh)
    assert abs(equations.residual(z)).max() < 1e-9 * equations.mean_flux(z)
    plain = case.equations()
    assert abs(plain.residual(z)).max() > 1e-3 * plain.mean_flux(z)


def test_relaxed_is_a_failure_where_it_is_not_allowed() -> None:
    with pytest.raises(em.SolveError, match="cross-line term") as caught:
        em.solve(two_peaks(33), allow_relaxed=False)
    partial = caught.value.solution
    assert partial.status is em.Status.NEWTON_FAILED
    assert partial.certificate.status is em.Status.NEWTON_FAILED
    assert not partial.mesh.is_folded
    assert partial.remedy.startswith("Lower a, raise b")


def test_a_term_that_helped_is_given_up_where_it_is_not_needed() -> None:
    """A front thinner than the coarsest cells: the term leads there, finer grids do without."""
    steep = em.ArcLength(u=em.Expression("tanh(100*(x - y))"), scaled=False)
    steps = list(single_domain_steps(em.Problem(monitor=steep, grid=em.Grid(n_xi=129, n_eta=129))))
    last = {step.grid.n_xi: step for step in steps}
    assert last[17].relaxation.cross_line > 0.0
    assert last[129].relaxation.is_none
    assert last[129].converged
    assert last[129].mesh.min_jacobian > 0.1


def test_the_strength_is_lowered_last() -> None:
    """a = 1 and b = 0 on a curved front of unbounded metric: less of the monitor, and it is said how much."""
    solution = em.solve(problem("wave", 17, a=1.0, b=0.0))
    assert solution.status is em.Status.RELAXED
    reached = {relaxed.what: relaxed for relaxed in solution.relaxed}
    assert reached["a"].asked == 1.0
    assert 0.2 < reached["a"].reached < 1.0
    assert not solution.mesh.is_folded
    assert f"a = {reached['a'].reached:.3g} of 1 and a cross-line term" in solution.note
    assert solution.remedy.startswith(f"Lower a to {reached['a'].reached:.2g} or less")


def test_relaxed_equations_are_not_solved_on_large_grids(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.single_domain.level.MAX_RELAXED_POINTS", 33 * 33)
    solution = em.solve(two_peaks(65))
    assert solution.status is em.Status.RELAXED
    assert {r.what: r.reached for r in solution.relaxed}["points"] == 33
    assert solution.mesh.x.shape == (65, 65)
    assert not solution.mesh.is_folded


def test_an_interpolated_mesh_is_not_called_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where sweeps fail on a grid too large for Newton's method, what is left is the solution of a coarser one."""
    monkeypatch.setattr("equimesh.single_domain.level.MAX_RELAXED_POINTS", 33 * 33)
    monkeypatch.setattr("equimesh.single_domain.level.MAX_SWEEPS", 1)
    solution = em.solve(problem("tanh20", 65))
    assert solution.status is em.Status.RELAXED
    assert [(r.what, r.asked, r.reached) for r in solution.relaxed] == [("points", 65.0, 33.0)]
    assert 1e-4 < solution.certificate.equation_residual < 0.5
    assert "A mesh of 33 x 33 points satisfies" in solution.note


@pytest.mark.parametrize("boundary", em.Boundary)
def test_the_cross_line_term_is_in_the_jacobian(boundary: em.Boundary) -> None:
    case = problem("ring", 9, 8, boundary=boundary)
    equations = case.equations(0.3)
    random = np.random.default_rng(5)
    z = equations.vector(em.Mesh.uniform(case.grid)) + 0.01 * random.standard_normal(2 * 72)
    direction = random.standard_normal(z.size)
    slope = equations.jacobian(z) @ direction
    errors = []
    for step in (1e-3, 5e-4):
        difference = equations.residual(z + step * direction) - equations.residual(z) - step * slope
        errors.append(np.linalg.norm(difference))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    plain = case.equations()
    assert np.linalg.norm(equations.residual(z) - plain.residual(z)) > 0.1


def test_a_monitor_without_a_solution_at_all_is_no_success() -> None:
    """Only the uniform mesh is left of a jump: that adapts to nothing, and is not called relaxed."""
    jump = em.Expression("where(x + 0.3*sin(7*y) < y, 100, 2)")
    solution = em.solve(
        em.Problem(monitor=em.ArcLength(u=jump, b=0.0, scaled=False), grid=em.Grid(n_xi=9, n_eta=9)), check=False
    )
    assert not solution.mesh.is_folded
    assert solution.status is em.Status.NEWTON_FAILED
    assert "No mesh was found" in solution.message
    assert solution.certificate.equation_residual > 1.0


# Newton's method without a matrix: the equations of the matrix, its products, and as few for every grid.


WEIGHT = 0.1


def started(points: int, boundary: em.Boundary = em.Boundary.TRACE) -> tuple[em.Problem, em.Mesh]:
    """A problem, and its uniform mesh with solved sides."""
    case = problem("ring", points, boundary=boundary)
    start = with_solved_sides(case, em.Mesh.uniform(case.grid))
    assert start is not None
    return case, start


def solved(interior: Interior, start: em.Mesh) -> tuple[em.Mesh, int]:
    """The mesh of Newton's method, down to rounding, and the number of its steps."""
    enough = 1e-11 * interior.mean_flux
    *_, last = newton_iterations(
        interior.residual,
        lambda z: z,
        interior.vector(start),
        admissible=interior.is_valid,
        tolerance=enough,
        factorise=interior.solver,
    )
    assert last.residual <= enough
    return interior.mesh(last.z), last.step


@pytest.mark.parametrize("boundary", em.Boundary)
def test_the_mesh_is_that_of_the_method_with_a_matrix(boundary: em.Boundary) -> None:
    case, start = started(17, boundary)
    weight = WEIGHT * scale(case)
    found, _ = solved(Interior(case, start, weight), start)
    *_, other = newton_steps(case.equations(weight), start)
    assert other.converged
    assert found.distance(other.mesh) < 1e-9


def test_products_are_those_with_the_jacobian() -> None:
    case, start = started(9)
    weight = WEIGHT * scale(case)
    interior, equations = Interior(case, start, weight), case.equations(weight)
    z = interior.vector(start)
    jacobian = equations.jacobian(equations.vector(start)).toarray()
    inside = np.zeros((9, 9), dtype=bool)
    inside[1:-1, 1:-1] = True
    kept = np.concatenate([inside.ravel(), inside.ravel()])
    matrix = jacobian[np.ix_(kept, kept)]
    right = np.random.default_rng(6).standard_normal(z.size)
    v = interior.solver(z)(right)
    assert np.linalg.norm(matrix @ v - right) <= 0.31 * np.linalg.norm(right)


def test_the_number_of_steps_does_not_grow_with_the_grid() -> None:
    counts = []
    for points in (17, 33, 65):
        case, start = started(points)
        counts.append(solved(Interior(case, start, WEIGHT * scale(case)), start)[1])
    assert max(counts) <= 12
    assert counts[2] <= counts[0] + 3


def test_the_unit_is_that_of_the_equations() -> None:
    case, start = started(9)
    equations = case.equations()
    expected = equations.mean_flux(equations.vector(start))
    assert Interior(case, start, 0.0).mean_flux == pytest.approx(expected)


def test_folded_and_undefined_meshes_are_not_valid() -> None:
    case, start = started(9)
    interior = Interior(case, start, 0.0)
    z: Array = interior.vector(start)
    assert interior.is_valid(z)
    far = z.copy()
    far[0] += 0.9
    assert not interior.is_valid(far)
    assert not interior.is_valid(np.full(z.size, np.nan))


def test_orthogonal_sides_follow_the_interior() -> None:
    case, start = started(9, em.Boundary.ORTHOGONAL)
    interior = Interior(case, start, 0.0)
    z = interior.vector(start)
    z[:49] += 0.001
    mesh = interior.mesh(z)
    assert -3.0 * mesh.x[1:-1, 0] + 4.0 * mesh.x[1:-1, 1] - mesh.x[1:-1, 2] == pytest.approx(0.0, abs=1e-14)
    assert (mesh.x[0] == 0.0).all()
    assert (mesh.x[-1] == 1.0).all()


# Levels without sweeps.


def step(points: int, **more: object) -> Step:
    grid = em.Grid(n_xi=points, n_eta=points)
    return Step(level=0, levels=2, grid=grid, step=0, residual=1.0, mesh=em.Mesh.uniform(grid), **more)  # type: ignore[arg-type]


def test_a_level_that_is_interpolated_names_the_grid_that_was_solved() -> None:
    relaxed = step(17, relaxation=Relaxation(strength=0.5))
    found = interpolated_level(step(33), relaxed)
    assert (found.relaxation, found.solved, found.converged) == (relaxed.relaxation, relaxed.grid, True)
    assert math.isnan(found.residual)
    again = interpolated_level(step(65), found)
    assert again.solved == relaxed.grid
    assert not again.is_exact


def test_noise_that_has_no_solution_is_a_failure_and_no_fault() -> None:
    """A rough solution was found there that no weight of the cross-line term makes one to the full tolerance."""
    axis = np.linspace(0.0, 1.0, 20)
    u = em.GridSamples(x=axis, y=axis, values=np.random.default_rng(1).random((20, 20)))
    solution = em.solve(em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=17, n_eta=9)), check=False)
    assert solution.status is em.Status.NEWTON_FAILED
    assert "smooth the monitor" in solution.message
    np.testing.assert_array_equal(solution.mesh.x, em.Mesh.uniform(solution.problem.grid).x)
