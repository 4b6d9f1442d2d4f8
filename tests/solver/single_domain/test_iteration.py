"""Nested iteration: the mesh of Newton's method, and the ways to it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import equimesh as em
from cases import FUNCTIONS, problem
from equimesh.single_domain import iteration
from equimesh.single_domain.iteration import single_domain_steps, steps_from
from equimesh.single_domain.level import MAX_ERROR_FROM_MESH, TIGHT_DEVIATION, Mode, Step
from equimesh.sweeps.deviation import deviation
from equimesh.sweeps.verdict import ALGEBRAIC_SHARE
from solver.sweeps.windows import distance

# Newton steps for tanh20 on 17, 33 and 65 points a side. Blessed numbers: those of today's solver, not of theory.
# Where a change moves them, check that the meshes stay the same, and write the new ones here in the same commit, with
# the reason in its message. Each level but the coarsest must go on needing fewer steps than that.
BLESSED_NEWTON_STEPS = [8, 4, 4]


def test_newton_steps_of_the_nested_iteration() -> None:
    """Counts for tanh20: each level starts from the coarser mesh and needs fewer steps."""
    last = {record.grid.n_xi: record for record in single_domain_steps(problem("tanh20", 65), sweeps=False)}
    assert [last[n].step for n in (17, 33, 65)] == BLESSED_NEWTON_STEPS
    assert all(record.converged for record in last.values())
    assert all(0.40 < record.mesh.min_jacobian < 0.42 for record in last.values())


@pytest.mark.parametrize(("name", "boundary"), list(zip(FUNCTIONS, itertools.cycle(em.Boundary), strict=False)))
def test_the_mesh_is_that_of_newton(name: str, boundary: em.Boundary) -> None:
    case = problem(name, 49, 41, boundary=boundary, b=0.1)
    *_, fast = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(case, sweeps=False)
    if reference.relaxation.is_none:
        assert fast.relaxation.is_none
        assert distance(fast.mesh, reference.mesh) < 1e-9
    assert reference.relaxation.is_none or boundary is not em.Boundary.TRACE


FLOWER = "1/(1 + exp((hypot(x-0.5, y-0.47) - 0.25 - 0.04*cos(6*atan2(y-0.47001, x-0.50001)))/0.012))"


@pytest.mark.parametrize("shape", [(65, 65), (129, 65), (40, 171)])
def test_a_mesh_is_found_on_every_shape_of_grid(shape: tuple[int, int]) -> None:
    """A bent thin front: coarse grids with few points in one direction have no mesh, square ones lead to it."""
    grid = em.Grid(n_xi=shape[0], n_eta=shape[1])
    *_, last = single_domain_steps(em.Problem(monitor=em.ArcLength(u=em.Expression(FLOWER), scaled=False), grid=grid))
    assert last.is_exact
    assert last.mesh.x.shape == shape


@pytest.mark.parametrize("u", ["tanh(100*(x - 0.37))", "tanh(100*(y - 0.37))"])
@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_fronts_along_a_coordinate_have_an_exact_mesh(
    u: str, boundary: em.Boundary, kind: type[em.ArcLength | em.Curvature]
) -> None:
    case = em.Problem(monitor=kind(u=em.Expression(u)), grid=em.Grid(n_xi=33, n_eta=33), boundary=boundary)
    *_, last = single_domain_steps(case)
    assert last.is_exact
    assert deviation(case.metric, case.boundary, last.mesh) < 1e-8


# The levels of a nested iteration.


@pytest.mark.parametrize("u", ["tanh(20*(x + y/2 - 0.6))", "tanh(20*(y - 0.5 - 0.25*sin(2*pi*x)))"])
def test_half_the_monitor_leads_up_to_one_on_which_sweeps_fail(u: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression(u), scaled=False), grid=em.Grid(n_xi=33, n_eta=33))

    def strengths() -> list[float]:
        seen: list[float] = []
        solution = em.solve(problem, observe=lambda step: seen.append(step.strength))
        assert solution.status is em.Status.CONVERGED
        assert solution.certificate.relaxed == ()
        return sorted(set(seen))

    with monkeypatch.context() as patch:
        patch.setattr(iteration, "newton_level", None)  # no Newton step is needed
        assert strengths() == [0.5, 1.0]
        patch.setattr(iteration.Climb, "_weaker", lambda *_: iter(()))
        with pytest.raises(TypeError):  # but for what is tested here
            strengths()


# Equidistribution on closed lines: it does not depend on where they begin, and the seam is a line like others.


N = 33


def rectangle(periodic: Any, cells: int = 0) -> em.Problem:
    """A front on a periodic square; its lines begin ``cells`` cells further."""
    begin = [cells / (N - 1) * (periodic in (name, "both")) for name in "xy"]
    u = em.Expression(f"tanh(1.5*(sin(2*pi*(x+{begin[0]!r}))*cos(2*pi*(y+{begin[1]!r}))-0.2))")
    grid = em.Grid(n_xi=N, n_eta=N)
    return em.Problem(monitor=em.ArcLength(u=u), grid=grid, domain=em.Rectangle(periodic=periodic))


def last(problem: em.Problem, **options: Any) -> Step:
    *_, end = single_domain_steps(problem, **options)
    return end


@pytest.mark.parametrize(("periodic", "axes"), [("x", (0,)), ("y", (1,)), ("both", (0, 1))])
@pytest.mark.parametrize("cells", [8, 5])
def test_meshes_do_not_depend_on_where_lines_begin(periodic: str, axes: tuple[int, ...], cells: int) -> None:
    one, other = last(rectangle(periodic)), last(rectangle(periodic, cells))
    assert one.is_exact
    assert other.is_exact
    for axis, (a, b) in enumerate(((one.mesh.x, other.mesh.x), (one.mesh.y, other.mesh.y))):
        rolled = np.roll(a[:-1, :-1], [-cells] * len(axes), axes) - cells / (N - 1) * (axis in axes)
        assert np.abs((rolled - b[:-1, :-1] + 0.5) % 1.0 - 0.5).max() < 1e-12


def test_a_ring_turned_by_whole_cells_has_the_turned_mesh() -> None:
    def solved(cells: int) -> em.Mesh:
        turn = 2 * np.pi * cells / 64
        u = em.Expression("tanh(8*(x*c-y*s-0.3))", parameters={"c": float(np.cos(turn)), "s": float(np.sin(turn))})
        domain = em.AnnulusSector(closed=True)
        return last(em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=17, n_eta=65), domain=domain)).mesh

    one, other = solved(0), solved(7)
    assert np.abs(np.roll(one.x[:, :-1], -7, 1) - other.x[:, :-1]).max() < 1e-12
    moved = np.roll(one.y[:, :-1], -7, 1) - 7 / 64 - other.y[:, :-1]
    assert np.abs((moved + 0.5) % 1.0 - 0.5).max() < 1e-12


def test_both_copies_of_a_seam_are_one_line_and_it_bends() -> None:
    mesh = last(rectangle("x")).mesh
    assert np.array_equal(mesh.x[-1], mesh.x[0] + 1.0)
    assert np.array_equal(mesh.y[-1], mesh.y[0])
    assert np.ptp(mesh.x[0]) > 0.01
    assert np.array_equal(mesh.y[:, 0], np.zeros(N))
    assert not mesh.is_folded


def test_a_constant_monitor_gives_the_uniform_mesh() -> None:
    problem = em.Problem(
        monitor=em.Weight(rho=em.Expression("1")), grid=em.Grid(n_xi=9, n_eta=13), domain=em.Rectangle(periodic="both")
    )
    assert last(problem).mesh.distance(em.Mesh.uniform(problem.grid)) < 1e-14


def test_the_same_function_across_x_and_across_y_has_the_transposed_mesh() -> None:
    def solved(u: str, periodic: Any) -> em.Mesh:
        monitor = em.ArcLength(u=em.Expression(u))
        problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=N, n_eta=N), domain=em.Rectangle(periodic=periodic))
        return last(problem).mesh

    one = solved("tanh(10*(y-0.5-0.15*sin(2*pi*x)))", "x")
    other = solved("tanh(10*(x-0.5-0.15*sin(2*pi*y)))", "y")
    assert one.distance(em.Mesh(other.y.T, other.x.T)) < 1e-12


@pytest.mark.parametrize("boundary", list(em.Boundary))
def test_sides_that_are_no_seams_keep_their_condition(boundary: em.Boundary) -> None:
    u = em.Expression("tanh(3*(x-0.3))")
    grid, domain = em.Grid(n_xi=9, n_eta=33), em.AnnulusSector(closed=True)
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=grid, domain=domain, boundary=boundary)
    end = last(problem)
    assert end.is_exact
    assert deviation(problem.metric, boundary, end.mesh) < 1e-11


def test_a_front_that_sweeps_cannot_solve_is_adapted_to_less() -> None:
    u = em.Expression("tanh(10*(sin(2*pi*x)*cos(2*pi*y)-0.3))")
    monitor = em.Curvature(u=u)
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=17, n_eta=17), domain=em.Rectangle(periodic="both"))
    end = last(problem, mode=Mode.DISCRETIZATION)
    assert end.converged
    assert not end.mesh.is_folded
    assert 0.0 < end.strength < 1.0


def test_a_solve_from_the_mesh_before_takes_few_sweeps() -> None:
    problem = rectangle("x")
    end = last(problem)
    *_, again = steps_from(problem, end.mesh)
    assert again.is_exact
    assert again.step <= 3
    assert again.mesh.distance(end.mesh) < 1e-12
    assert last(problem, start=em.Mesh.uniform(problem.grid)).mesh.distance(end.mesh) < 1e-12


def test_a_solve_from_a_near_mesh_leaves_an_error_far_below_that_of_its_cells() -> None:
    before, case = em.solve(problem("tanh20", 33)).reference, problem("tanh20", 33, a=0.65)
    (*_, usual), (*_, tight) = (list(steps_from(case, before, mode=mode)) for mode in (Mode.DISCRETIZATION, Mode.TIGHT))
    assert usual.is_exact
    assert 0.0 < usual.mesh.distance(tight.mesh) < MAX_ERROR_FROM_MESH / 32
    assert 2 * usual.step < tight.step


def test_it_converges_on_all_functions_with_the_trace_condition() -> None:
    for name in FUNCTIONS:
        *_, last = iteration.single_domain_steps(problem(name, 65))
        assert last.converged
        assert last.residual < TIGHT_DEVIATION, "the finest level was not solved by sweeps to their tolerance"
        assert last.algebraic_error > 0.0, "sweeps, not Newton steps"


# Sweeps for tanh20 by points a side. Blessed numbers: those of today's solver, not of theory. Where a change moves
# them, check that meshes are as accurate as before, and write the new ones here in the commit that explains the change.
BLESSED_SWEEPS = {17: 9, 33: 2, 65: 2, 129: 2, 257: 1}


def test_sweeps_do_not_grow_with_the_number_of_points() -> None:
    case = problem("tanh20", 257)
    tight = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case)}
    assert tight[257] <= 11
    usual = {step.grid.n_xi: step.step for step in iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)}
    assert usual == BLESSED_SWEEPS


@pytest.mark.parametrize("name", ["tanh20", "paper", "ring", "wave"])
def test_the_usual_mode_leaves_a_fifth_of_the_discretisation_error(name: str) -> None:
    """Both errors against meshes that know better: the tight one of the same grid, and the tight one of a finer."""
    case, finer = problem(name, 129), problem(name, 513)
    *_, usual = iteration.single_domain_steps(case, mode=em.Mode.DISCRETIZATION)
    *_, tight = iteration.single_domain_steps(case)
    *_, reference = iteration.single_domain_steps(finer)
    exact = em.Mesh(reference.mesh.x[::4, ::4], reference.mesh.y[::4, ::4])
    algebraic, discretization = distance(usual.mesh, tight.mesh), distance(tight.mesh, exact)
    assert algebraic <= ALGEBRAIC_SHARE * discretization
    assert usual.discretization_error == pytest.approx(discretization, rel=0.5)
    assert algebraic > 0.0, "the tight mode would have been no dearer"
