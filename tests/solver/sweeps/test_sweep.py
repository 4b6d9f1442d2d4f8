"""Sweeps of line corrections: exact on the leading part, at rest on a solution, the same on any number of threads."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import Cells
from equimesh.equations.problem import Problem
from equimesh.meshes.nested import Closed, padded
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array
from equimesh.single_domain import iteration, level
from equimesh.sweeps.closed_lines import copy_ends
from equimesh.sweeps.deviation import deviation
from equimesh.sweeps.one_strip import MAX_SWEEPS_AT_ONCE, Given, is_one_strip
from equimesh.sweeps.sweep import WHOLE, Correction, Frame, SideNodes, Sweep, halve_moves, memory_needed, take_midpoints
from equimesh.sweeps.verdict import (
    CONTRACTION,
    DONE,
    GO_ON,
    GRID_ERROR,
    HALVE,
    LEFT,
    LOST,
    MAX_SLOW_SWEEPS,
    RESIDUAL,
    Rules,
    error_left,
    judge,
    nothing_known,
)
from solver.sweeps.windows import distance, disturbed, sweep_on


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    """Bit for bit: the strips that are shared out are always the same."""
    case = problem("ring", 301, 257)
    solutions = [em.solve(case, threads=threads) for threads in (1, 2, 3)]
    assert len({(s.mesh.x.tobytes(), s.mesh.y.tobytes(), s.residual, s.discretization_error) for s in solutions}) == 1
    meshes = [list(iteration.single_domain_steps(case, threads=threads))[-1].mesh for threads in (1, 2, 3, 1)]
    assert all(np.array_equal(meshes[0].x, mesh.x) and np.array_equal(meshes[0].y, mesh.y) for mesh in meshes[1:])
    sweep = sweep_on(case, threads=3)
    assert len(sweep.rows.shares) == 3


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
def test_deviation_is_that_of_the_equations(domain: em.Domain) -> None:
    """The kernels against the fluxes of the Newton equations, on a mesh that is no solution."""
    case = problem("ring", 9, 12, b=0.3)
    case = em.Problem(monitor=case.monitor, grid=case.grid, domain=domain)
    mesh = disturbed(case)
    window = case.equations().window(case.equations().vector(mesh))
    bottom, top, left, right = (2 * flux.value for flux in Cells(window).fluxes)
    xi, eta = (top[:, :-1] + bottom[:, 1:]) / 2, (right[:-1] + left[1:]) / 2
    expected = max(abs(xi / xi.mean(axis=0) - 1).max(), abs(eta.T / eta.mean(axis=1) - 1).max())
    assert deviation(case.metric, case.boundary, mesh) == pytest.approx(expected, rel=1e-12)


def test_one_sweep_solves_the_leading_part() -> None:
    """With a constant metric only the squares are left out of the leading part: the error falls to its square."""
    case = problem("ring", 14, 11, a=0.0)
    uniform, ratios = em.Mesh.uniform(case.grid), []
    for size in (1e-2, 1e-3):
        bump = size * np.sin(np.pi * uniform.x) * np.sin(np.pi * uniform.y)
        sweep, start = sweep_on(case), em.Mesh(uniform.x + bump, uniform.y - bump)
        found = sweep.correct(start.x, start.y)
        moved = em.Mesh(sweep.new_x, sweep.new_y)
        ratios.append(distance(moved, uniform) / distance(start, uniform))
        assert found.move == pytest.approx(distance(moved, start), rel=1e-12)
    assert ratios[0] < 0.1
    assert ratios[1] < 0.2 * ratios[0]


def test_the_solution_stays_where_it_is() -> None:
    case = problem("tanh20", 33)
    *_, last = iteration.single_domain_steps(case)
    assert sweep_on(case).correct(last.mesh.x, last.mesh.y).move < 1e-11


def test_what_is_not_a_number_is_no_convergence() -> None:
    """One bad value on one line: every comparison with it is false, and must not count as a small deviation."""

    class Hole:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            bad = np.where((abs(x - 0.5) < 0.01) & (abs(y - 0.5) < 0.01), np.nan, x)
            return tuple(bad.copy() for _ in range((1, 3, 6)[order]))

    case = em.Problem(monitor=em.ArcLength(u=Hole()), grid=em.Grid(n_xi=9, n_eta=9))
    mesh = em.Mesh.uniform(case.grid)
    found = sweep_on(case).correct(mesh.x, mesh.y)
    assert found.deviation == np.inf
    solution = em.solve(case, check=False)
    assert not solution.status.succeeded
    assert not solution.mesh.is_folded


def test_a_guarded_sweep_halves_its_moves_until_nothing_folds() -> None:
    """Nodes that overshoot by three cells: a quarter of the move is the first share that is valid."""
    case = problem("ring", 9)
    sweep = Sweep(case.metric, case.boundary, Rows.whole((9, 9)), np.empty(memory_needed((9, 9))))
    mesh = em.Mesh.uniform(case.grid)

    def overshoot(cells: float) -> None:
        sweep.new_x[:], sweep.new_y[:] = mesh.x, mesh.y
        sweep.new_x[4, 4] += cells / 8

    overshoot(3.0)
    found = Correction(2.0, 3 / 8)
    taken = sweep.guard(mesh.x, mesh.y, found, measure=lambda x, y: float(x[4, 4] - y[4, 4]))
    assert taken.share == 0.25
    assert taken.smallest == sweep.smallest_jacobian > 0.0
    assert (taken.deviation, taken.move, taken.gap) == (2.0, 3 / 8, 3 / 32)
    assert sweep.new_x[4, 4] == mesh.x[4, 4] + 3 / 32
    overshoot(0.5)
    assert sweep.guard(mesh.x, mesh.y, found).share == 1.0
    assert np.isnan(sweep.guard(mesh.x, mesh.y, found).gap)
    assert sweep.guard(mesh.x, mesh.y, found, halve=True).share == 0.5
    overshoot(1000.0)
    least = sweep.guard(mesh.x, mesh.y, found)
    assert (least.share, least.smallest) == (1 / 64, 0.0)
    overshoot(0.5)
    assert sweep.guard(mesh.x, mesh.y, found, floor=1.0).smallest == 0.0, "no share of a move is above this floor"


def test_each_way_to_halve_a_move_keeps_its_rounding() -> None:
    """Where a coordinate grows by more than a factor of two, the two ways differ in the last bit."""
    rng = np.random.default_rng(3)
    old = rng.random((50, 50)) * 1e-2
    new = old * 7.3
    halved, middle = new.copy(), new.copy()
    halve_moves(halved, old)
    take_midpoints(middle, old)
    assert (halved == old + (new - old) * 0.5).all()
    assert (middle == (new + old) * 0.5).all()
    assert 0.0 < abs(halved - middle).max() < 1e-16


# The kernels of closed lines: means along lines, and rows of copies.


PERIODIC = {(True, False): "x", (False, True): "y", (True, True): "both"}


@pytest.mark.parametrize("closed", PERIODIC)
def test_every_closed_line_keeps_its_mean_from_the_first_sweep(closed: Closed) -> None:
    monitor = em.ArcLength(u=em.Expression("sin(2*pi*x)*cos(2*pi*y)+0.3*sin(2*pi*(x+y))"))
    domain = em.Rectangle(periodic=PERIODIC[closed])  # type: ignore[arg-type]
    problem = em.Problem(monitor=monitor, grid=em.Grid(n_xi=41, n_eta=29), domain=domain)
    start = padded(em.Mesh.uniform(problem.grid), closed)
    x, y = start.x, start.y
    sweep = Sweep(
        problem.metric, problem.boundary, Rows.whole(x.shape), np.empty(memory_needed(x.shape)), Frame.around(closed)
    )
    for _ in range(2):
        sweep.correct(x, y)
        x, y = sweep.swap(x, y)
    lines = slice(1, -1)
    if closed[1]:
        assert np.abs(y[lines, lines].mean(axis=1) - 0.5 * 27 / 28).max() < 1e-14
    elif closed[0]:
        assert np.abs(x[lines, lines].mean(axis=0) - 0.5 * 39 / 40).max() < 1e-7
    for axis, q in enumerate((x, y)):
        if closed[axis]:
            moved = np.moveaxis(q, axis, 0)
            assert np.array_equal(moved[-1], moved[1] + 1.0)
            assert np.array_equal(moved[0], moved[-2] - 1.0)


@pytest.mark.parametrize("axis", [0, 1])
def test_outermost_lines_are_copies_of_the_other_side(axis: int) -> None:
    q = np.arange(20.0).reshape(4, 5)
    copy_ends(q, axis, 100.0)
    lines = np.moveaxis(q, axis, 0)
    assert np.array_equal(lines[0], lines[-2] - 100.0)
    assert np.array_equal(lines[-1], lines[1] + 100.0)


# The error that moves leave which shrink by a factor each.


@pytest.mark.parametrize("contraction", [0.0, 0.1, 0.5, 0.9])
def test_it_is_the_sum_of_the_moves_to_come(contraction: float) -> None:
    moves = [3.0 * contraction**k for k in range(1, 1000)]
    assert error_left(3.0, contraction) == pytest.approx(sum(moves), abs=1e-12)


@pytest.mark.parametrize("contraction", [1.0, 1.5])
def test_moves_that_do_not_shrink_leave_an_error_without_bound(contraction: float) -> None:
    assert error_left(1e-9, contraction) == math.inf
    assert error_left(0.0, contraction) == 0.0


RULES = Rules(tight=False, known=True, has_coarse=True, tolerance=1e-10, start_error=1e-3, contraction=0.5, per_gap=3.0)


def test_a_level_is_solved_at_a_fifth_of_the_error_of_its_grid() -> None:
    record, known = np.array([0.1, 0.0, 0.0, 0.0]), nothing_known(1.0)
    assert judge(RULES, known, 0.21, 1.0, 3.0, record) == GO_ON
    assert judge(RULES, nothing_known(1.0), 0.19, 1.0, 3.0, record) == DONE
    assert record[LEFT] == pytest.approx(0.19)
    assert record[CONTRACTION] == 0.5
    assert record[GRID_ERROR] == 1.0
    assert judge(RULES, known, 0.1, 0.5, 3.0, record) == GO_ON, "nothing is known of what a shortened sweep leaves"


def test_without_a_coarser_solution_it_is_the_start_of_a_finer_one() -> None:
    rules, record = RULES._replace(known=False, has_coarse=False), np.array([0.1, 0.0, 0.0, 0.0])
    assert judge(rules, nothing_known(1.0), 2e-3, 1.0, np.nan, record) == GO_ON
    assert judge(rules, nothing_known(1.0), 1e-3, 1.0, np.nan, record) == DONE


def test_a_tight_level_is_solved_at_its_tolerance() -> None:
    record = np.array([2e-10, 0.0, 0.0, 0.0])
    rules = RULES._replace(tight=True)
    assert judge(rules, nothing_known(1.0), 1e-12, 1.0, np.nan, record) == GO_ON
    record[RESIDUAL] = 1e-10
    assert judge(rules, nothing_known(1.0), 1e-2, 1.0, np.nan, record) == DONE


def test_slow_sweeps_are_halved_and_then_given_up() -> None:
    record, known = np.array([0.1, 0.0, 0.0, 0.0]), nothing_known(1.0)
    verdicts = [judge(RULES, known, 1.0, 1.0, 3.0, record) for _ in range(MAX_SLOW_SWEEPS + 1)]
    assert known[HALVE] == 0.0
    verdicts.append(judge(RULES, known, 1.0, 1.0, 3.0, record))
    assert known[HALVE] == 1.0
    assert verdicts == [GO_ON] * (MAX_SLOW_SWEEPS + 2)
    again = [judge(RULES, known, 1.0, 1.0, 3.0, record) for _ in range(MAX_SLOW_SWEEPS + 2)]
    assert again == [GO_ON] * (MAX_SLOW_SWEEPS + 1) + [LOST]


# Cases that are also solved as far as the discretisation needs: of u, of samples, of a metric, and of sides.
SOME = ("samples", "formula", "lost", "flat sides", "metric of points")
Found: TypeAlias = list[tuple[object, ...]]


class Saddle:
    """A function of a user, whose code is not compiled."""

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        u = x * y + np.sin(3 * x)
        return (u,) if order == 0 else (u, y + 3 * np.cos(3 * x), x + 0.0 * y)


def samples(points: int = 65, steepness: float = 20.0) -> em.GridSamples:
    line = np.linspace(0.0, 1.0, points)
    return em.GridSamples(x=line, y=line, values=np.tanh(steepness * (np.add.outer(line, line / 2) - 0.75)))


def arc_length(u: em.Field, n_xi: int, n_eta: int, domain: em.Domain | None = None, **options: str) -> em.Problem:
    boundary = em.Boundary(options.get("boundary", "trace"))
    monitor, grid = em.ArcLength(u=u), em.Grid(n_xi=n_xi, n_eta=n_eta)
    return em.Problem(monitor=monitor, grid=grid, boundary=boundary, domain=domain or em.Rectangle())


STEEP = em.Expression("tanh(200*(x - y))")
CASES = {
    "samples": arc_length(samples(), 65, 65),
    "few nodes": arc_length(samples(), 20, 24),
    "no common nodes": arc_length(samples(), 50, 70),
    "many samples": arc_length(samples(200), 33, 33),
    "formula": problem("ring", 65),
    "long": problem("tanh20", 20, 90),
    "halved moves": arc_length(samples(129, 60.0), 33, 33),
    "lost": arc_length(STEEP, 33, 33),
    "flat sides": arc_length(samples(), 33, 40, boundary="equidistributed_1d"),
    "domain": arc_length(em.Expression("sin(3*x)*y"), 33, 33, em.Rectangle(x=(0, 2), y=(-1, 1))),
    "own code": arc_length(Saddle(), 40, 40),
    "metric of points": em.Problem(monitor=em.Curvature(u=STEEP), grid=em.Grid(n_xi=10, n_eta=10)),
}


def found(case: em.Problem, mode: em.Mode) -> Found:
    """The numbers and the meshes of all steps."""
    steps = []
    for step in iteration.single_domain_steps(case, mode=mode):
        numbers = (step.residual, step.algebraic_error, step.discretization_error, step.contraction)
        mesh = step.snapshot().mesh
        steps.append((step.level, step.step, step.converged, *map(str, numbers), mesh.x.tobytes(), mesh.y.tobytes()))
    return steps


@pytest.mark.parametrize(
    ("name", "mode"), [*((name, em.Mode.TIGHT) for name in CASES), *((name, em.Mode.DISCRETIZATION) for name in SOME)]
)
def test_steps_are_those_of_sweeps_one_by_one(name: str, mode: em.Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    here = found(CASES[name], mode)
    monkeypatch.setattr(level, "is_one_strip", lambda *_: False)
    there = found(CASES[name], mode)
    assert [step[:7] for step in here] == [step[:7] for step in there]
    assert here == there


@pytest.mark.parametrize("points", [25, 10**6])
def test_a_spline_and_a_formula_are_evaluated_inside(points: int) -> None:
    for name in ("samples", "formula"):
        given = Given.of(CASES[name].metric, points)
        assert given.is_given
        assert given.at_nodes.order == (points == 25)
        assert given.on_sides.order == 1
    # Its polynomials would not stay in the cache.
    assert not Given.of(CASES["many samples"].metric, points).is_given


def test_every_step_has_its_own_mesh() -> None:
    """An observer may hear of several sweeps at a time."""
    meshes = [step.snapshot().mesh for step in iteration.single_domain_steps(CASES["halved moves"])]
    assert len(meshes) > 2 * MAX_SWEEPS_AT_ONCE
    assert len({mesh.x.tobytes() for mesh in meshes}) >= len(meshes) - 4, "the last steps of levels may be at rest"


def test_larger_grids_and_orthogonal_sides_are_swept_one_by_one() -> None:
    case = CASES["samples"]
    assert is_one_strip(case, Rows.whole((181, 181)))
    assert not is_one_strip(case, Rows.whole((257, 257)))
    orthogonal = arc_length(samples(), 33, 33, boundary="orthogonal")
    assert not is_one_strip(orthogonal, Rows.whole((33, 33)))


def test_nodes_that_are_nowhere_end_the_sweeps() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 1, 17), indexing="ij")
    x[3, 4] = np.nan
    case = arc_length(samples(), 17, 17)
    *_, last = iteration.steps_from(case, em.Mesh(x, y))
    assert last.converged
    assert not last.mesh.is_folded


U = em.Expression("tanh(9*(x + y/2 - 0.7))")


def on_domain(shape: tuple[int, int], domain: em.Domain, monitor: em.Monitor) -> Problem:
    return Problem(monitor=monitor, grid=em.Grid(n_xi=shape[0], n_eta=shape[1]), domain=domain)


def bent(shape: tuple[int, int]) -> em.Mesh:
    """A smooth mesh of the reference square that solves nothing."""
    start = em.Mesh.uniform(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    x, y = start.x, start.y
    return em.Mesh(x + 0.1 * x * (1 - x) * (1 + y), y - 0.1 * np.sin(np.pi * y) * np.sin(3 * x))


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector()], ids=["square", "sector"])
@pytest.mark.parametrize("monitor", [em.ArcLength(u=U), em.Weight(rho=em.Expression("1 + x*y"))])
@pytest.mark.parametrize("shape", [(4, 4), (40, 7), (301, 150)])
def test_it_is_that_of_a_sweep(domain: em.Domain, monitor: em.Monitor, shape: tuple[int, int]) -> None:
    case, mesh = on_domain(shape, domain, monitor), bent(shape)
    swept = Sweep(case.metric, case.boundary, Rows.whole(shape), np.empty(memory_needed(shape))).correct(mesh.x, mesh.y)
    found = deviation(case.metric, case.boundary, mesh)
    assert found == pytest.approx(swept.deviation, rel=1e-12)
    assert deviation(case.metric, case.boundary, mesh, threads=3) == found
    u = case.metric.u(mesh.x, mesh.y)
    assert deviation(case.metric, case.boundary, mesh, u=u) == pytest.approx(found, rel=1e-12)
    assert found > 1e-3


def test_a_length_that_is_not_a_number_makes_it_infinite() -> None:
    case, mesh = on_domain((9, 9), em.Rectangle(), em.ArcLength(u=U)), bent((9, 9))
    x = mesh.x.copy()
    x[4, 4] = math.nan
    assert deviation(case.metric, case.boundary, em.Mesh(x, mesh.y)) == math.inf


# The deviation of a mesh with closed lines, against lengths that are computed one by one.


def test_the_deviation_is_the_largest_one_of_all_lines() -> None:
    on_domain = em.Problem(
        monitor=em.Weight(rho=em.Expression("1")), grid=em.Grid(n_xi=5, n_eta=6), domain=em.Rectangle(periodic="both")
    )
    mesh = em.Mesh.uniform(on_domain.grid)
    mesh.x[0] -= 0.05  # the seam of the xi-lines
    mesh.x[-1] -= 0.05
    found = deviation(on_domain.metric, on_domain.boundary, mesh)
    lengths = np.array([0.3, 0.25, 0.25, 0.2]) ** 2
    assert found == pytest.approx(np.abs(lengths - lengths.mean()).max() / lengths.mean())


def test_a_node_that_is_no_number_has_no_deviation() -> None:
    on_domain = em.Problem(
        monitor=em.Weight(rho=em.Expression("1")), grid=em.Grid(n_xi=5, n_eta=6), domain=em.Rectangle(periodic="y")
    )
    mesh = em.Mesh.uniform(on_domain.grid)
    mesh.x[2, 2] = np.nan
    assert deviation(on_domain.metric, on_domain.boundary, mesh) == np.inf


def test_the_sides_move_with_the_interior() -> None:
    """Nodes on the sides go where the equations of the sides want them, also at right angles to a moving interior."""
    for boundary in em.Boundary:
        case = problem("tanh20", 33, boundary=boundary, b=0.5)
        *_, last = iteration.single_domain_steps(case)
        equations = case.equations()
        assert abs(equations.residual(equations.vector(last.mesh))).max() < 1e-9 * equations.mean_flux(
            equations.vector(last.mesh)
        )
        assert abs(last.mesh.x[:, 0] - np.linspace(0, 1, 33)).max() > 1e-3


# Frames: where the lines of a window begin and end.


def test_lines_end_one_node_before_a_side_that_yields() -> None:
    frame = Frame(physical=((False, True), (False, False)), beyond=((7.0, 0.0), (0.0, 3.0)))
    assert frame.span(0, 12) == (1, 11)
    assert frame.span(1, 9) == (0, 7)


def test_the_lines_of_the_whole_grid_are_whole() -> None:
    assert WHOLE.physical == ((True, True), (True, True))
    assert (WHOLE.span(0, 12), WHOLE.span(1, 9)) == ((0, 11), (0, 8))


# The nodes along the sides, in full.


SHAPE = (130, 2049)
X, Y = np.random.default_rng(5).random((2, *SHAPE))


def test_moved_sides_are_new_ones() -> None:
    whole = SideNodes.of(X, Y)
    moved = whole.moved(whole.along_eta, -whole.along_xi)
    assert np.array_equal(moved.along_eta, 2 * Y[[0, -1]])
    assert not moved.along_xi.any()
