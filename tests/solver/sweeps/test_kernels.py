"""Compiled loops and sums along lines, each against the formula that it writes out."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import Cells, SeenGradient
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import defects, directions
from equimesh.sweeps import kernels
from equimesh.sweeps.kernels import Lines, Moved, Nodes
from equimesh.sweeps.line_sums import MARGIN, LineSums, cell_memory, cell_metrics
from equimesh.sweeps.sweep import ShareSweep
from solver.sweeps.windows import disturbed

SECTOR = em.AnnulusSector(angles=(0, 110))


def case_on(domain: em.Domain) -> em.Problem:
    return em.Problem(monitor=problem("ring", 9, b=0.3).monitor, grid=em.Grid(n_xi=9, n_eta=7), domain=domain)


@pytest.mark.parametrize("domain", [em.Rectangle(), em.Rectangle(x=(0, 3)), SECTOR], ids=["square", "wide", "sector"])
def test_cell_metrics_are_those_of_the_newton_equations(domain: em.Domain) -> None:
    """M = B + k g g^T, with g as the cell sees it."""
    case = case_on(domain)
    mesh = disturbed(case)
    found = np.empty((3, 8, 6))
    cell_metrics(case.metric, mesh.x, mesh.y, found)
    cells = Cells(case.equations().window(case.equations().vector(mesh)))
    seen: SeenGradient = cells.seen
    g, base = seen.gradient, case.metric.base(*cells.centre)
    k, _, _ = case.metric.strength(g, base)
    expected = base[0] + k * g[0] ** 2, base[1] + k * g[0] * g[1], base[2] + k * g[1] ** 2
    assert found == pytest.approx(np.array(expected), rel=1e-11)


def test_segment_sums_are_sums_of_edges() -> None:
    case = case_on(em.Rectangle())
    mesh = disturbed(case)
    cells = np.empty((3, 8, 6))
    cell_metrics(case.metric, mesh.x, mesh.y, cells)
    window = case.equations().window(case.equations().vector(mesh))
    bottom, top, left, right = (flux.value for flux in Cells(window).fluxes)
    xi, eta = (top[:, :-1] + bottom[:, 1:]) / 64, (right[:-1] + left[1:]) / 36
    cuts, along_xi, along_eta = np.array([0, 2, 6]), np.empty(7), np.zeros((2, 9))
    kernels.segment_sums(kernels.Nodes(mesh.x, mesh.y), cells, (0, 5), cuts, along_xi, along_eta)
    assert along_xi[1:-1] == pytest.approx(xi[:5].sum(axis=0))
    assert along_eta[0, 1:5] == pytest.approx(eta[:4, :2].sum(axis=1))
    assert along_eta[1, 1:5] == pytest.approx(eta[:4, 2:].sum(axis=1))
    assert not along_eta[:, 5:].any(), "rows of another thread are left alone"


def side_moves(t: np.ndarray, a: float) -> tuple[float, float, np.ndarray, np.ndarray]:
    """The moves of the nodes at ``t`` on two equal sides on which u = 3 t; the second is no physical one."""
    both, n = np.stack([t, t]), t.size
    base = np.array([1.0, 0.0, 1.0])[:, None, None] * np.ones((2, n - 1))
    flux, moves = np.zeros((2, n - 1)), np.full((2, n), 7.0)
    sides = kernels.SidePair(both, 3 * both, 0 * both, base)
    lines = kernels.Lines(0, n - 1, np.zeros((2, 2)), (0.0, 0.0), np.zeros((2, 2)))
    deviation, largest = kernels.side_moves(sides, (a**2, 0.0), (True, False), lines, flux, moves)
    return deviation, largest, flux, moves


@pytest.mark.parametrize("a", [0.0, 1.0])
def test_nodes_of_a_side_move_to_equal_lengths(a: float) -> None:
    t = np.linspace(0, 1, 6)
    deviation, largest, flux, moves = side_moves(t, a)
    assert deviation == pytest.approx(0.0, abs=1e-14)
    assert largest == pytest.approx(0.0, abs=1e-14)
    assert flux[0] == pytest.approx((1 + 9 * a**2) / 25)
    bent = t + 0.001 * np.sin(np.pi * t)
    deviation, largest, flux, moves = side_moves(bent, a)
    assert deviation == pytest.approx(abs(flux[0] / flux[0].mean() - 1).max())
    assert largest == abs(moves[0]).max()
    assert bent + moves[0] == pytest.approx(t, abs=1e-5)
    assert (moves[0, 0], moves[0, -1]) == (0.0, pytest.approx(0.0, abs=1e-12))
    assert (moves[1] == 7.0).all(), "a side that is not physical is left alone"


def test_what_is_not_a_number_is_an_infinite_deviation() -> None:
    t = np.linspace(0, 1, 6)
    t[2] = np.nan
    assert side_moves(t, 1.0)[0] == np.inf


# The share of a thread: it writes its own rows only, and all shares together do the work of the whole.


SHAPE = (301, 257)


def swept(mesh: em.Mesh, case: em.Problem, threads: int) -> tuple[Moved, list[float]]:
    """Both phases on every share, one after the other; what no share writes stays 7."""
    rows, summed = Rows.whole(SHAPE, threads), SHAPE[0] - 1
    x, y, squares = (np.full(SHAPE, 7.0) for _ in range(3))
    out, sums = Moved(x, y, np.full((2, *SHAPE), 7.0, dtype=np.float32), squares), LineSums(rows, summed)
    none = [np.zeros((2, SHAPE[1 - k])) for k in (0, 1)]
    lines = [Lines(0, SHAPE[k] - 1, none[k], (0.0, 0.0), none[k]) for k in (0, 1)]
    nodes, still = Nodes(mesh.x, mesh.y), (np.zeros((2, SHAPE[1])), np.zeros((2, SHAPE[0])))
    sweeps = [ShareSweep(case.metric, rows, share, summed) for share in rows.shares]
    found = [sweep.along_eta(nodes, None, still, lines[1], out, sums) for sweep in sweeps]
    sums.solve(lines[0])
    for sweep, share in zip(sweeps, rows.shares, strict=True):
        before = x.copy()
        found += sweep.along_xi(nodes, out, sums)
        inside = x[:, 1:-1] != before[:, 1:-1]
        others = np.delete(inside, np.s_[share.rows], axis=0)
        assert not others.any(), "a thread writes its own rows only"
        assert inside.any()
    return out, found


@pytest.mark.parametrize("threads", [2, 3])
def test_threads_do_the_work_of_the_whole_to_the_last_bit(threads: int) -> None:
    case = problem("ring", *SHAPE)
    mesh = disturbed(case, 1e-4)
    (whole, (deviation, *most)), (cut, found) = (swept(mesh, case, count) for count in (1, threads))
    assert all(np.array_equal(one, other) for one, other in zip(whole, cut, strict=True))
    assert max(found[:threads]) == deviation
    assert [max(found[threads::2]), max(found[threads + 1 :: 2])] == most


LINES = (1030, 2100)  # 65 strips
STRIPS = np.random.default_rng(7).random((65, LINES[1]))
FIRST, LEFT, RIGHT = np.random.default_rng(8).random((3, LINES[1]))
ENDS = LINES[0] - 1
NONE = np.zeros((2, LINES[1]))


def test_the_lines_are_those_of_sums_in_order() -> None:
    sums = LineSums(Rows.whole(LINES), ENDS)
    sums.strips[:], sums.first[:], sums.pushes[:] = STRIPS, FIRST, (LEFT, RIGHT)
    deviation = sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE))
    inner = slice(1, -1)
    total = FIRST + STRIPS.sum(axis=0)
    rows = np.array([last - first for first, last in Rows.whole(LINES).node_strips])
    assert rows.sum() + 1 == ENDS
    mean, shift = total / ENDS, (RIGHT - LEFT) / ENDS
    assert sums.levels.mean[inner] == pytest.approx(mean[inner], rel=1e-13)
    assert sums.levels.shift[inner] == pytest.approx(shift[inner], rel=1e-13)
    start = LEFT + FIRST - mean + shift
    before = np.cumsum(STRIPS, axis=0) - STRIPS
    for k in range(65):
        expected = start + before[k] + rows[:k].sum() * (shift - mean)
        np.testing.assert_allclose(sums.starts[k][inner], expected[inner], rtol=1e-11, atol=1e-11)
    assert deviation == pytest.approx((abs(FIRST - mean) / mean)[inner].max(), rel=1e-13)


def test_a_line_that_is_not_a_number_is_no_convergence() -> None:
    sums = LineSums(Rows.whole(LINES), ENDS)
    sums.strips[:] = STRIPS
    sums.strips[40, 77] = np.nan
    sums.first[:] = FIRST
    assert sums.solve(Lines(0, ENDS, NONE, (0.0, 0.0), NONE)) == np.inf


# The metric of cells: a stencil of u for the arc length, values at the centres for all other monitors.


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector(angles=(0, 120))], ids=["square", "annulus"])
@pytest.mark.parametrize("kind", [em.ArcLength, em.Curvature])
def test_rows_do_not_depend_on_the_other_rows(kind: type, domain: em.Domain) -> None:
    """To the last bit, and with u given at the nodes or not."""
    monitor = kind(u=em.Expression("tanh(5*(x - y))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=9, n_eta=7), domain=domain)
    mesh = disturbed(case, 1e-3)
    whole, some = np.empty((3, 8, 6)), np.empty((3, 3, 6))
    cell_metrics(case.metric, mesh.x, mesh.y, whole)
    rows = slice(2, 6)
    cell_metrics(case.metric, mesh.x[rows], mesh.y[rows], some, case.metric.u(mesh.x[rows], mesh.y[rows]))
    assert np.array_equal(some, whole[:, 2:5])
    assert (whole[0] * whole[2] - whole[1] ** 2 > 0.0).all()


def test_a_linear_u_has_the_metric_of_the_formula() -> None:
    case = em.Problem(
        monitor=em.ArcLength(u=em.Expression("2*x + y"), a=0.8, b=0.5, scaled=False), grid=em.Grid(n_xi=6, n_eta=5)
    )
    mesh, found = disturbed(case), np.empty((3, 5, 4))
    cell_metrics(case.metric, mesh.x, mesh.y, found)
    k = 0.8**2 / (1.0 + 0.5 * 5.0)
    for entry, expected in zip(found, (1.0 + 4.0 * k, 2.0 * k, 1.0 + k), strict=True):
        assert entry == pytest.approx(np.full((5, 4), expected), rel=1e-12)


def test_the_memory_of_cells_lies_apart_from_all_other() -> None:
    cells = cell_memory(3, 9)
    whole = cells.base
    while whole.base is not None:
        whole = whole.base
    before = (cells.ctypes.data - whole.ctypes.data) // 8
    after = whole.size - before - cells.size
    assert cells.shape == (3, 3, 8)
    assert cells.flags.c_contiguous
    assert min(before, after) >= MARGIN + 2 * 8


# The defects are those of the equations that Newton's method with a matrix solves.


def bent(case: em.Problem) -> tuple[Array, Array, Array]:
    """A mesh with random moves inside, and the metric of its cells."""
    mesh, rng = em.Mesh.uniform(case.grid), np.random.default_rng(4)
    x, y = mesh.x.copy(), mesh.y.copy()
    for q in (x, y):
        q[1:-1, 1:-1] += 0.01 * rng.standard_normal((x.shape[0] - 2, x.shape[1] - 2))
    cells = np.empty((3, x.shape[0] - 1, x.shape[1] - 1))
    cell_metrics(case.metric, x, y, cells)
    return x, y, cells


@pytest.mark.parametrize("weight", [0.0, 0.7])
@pytest.mark.parametrize("shape", [(9, 9), (8, 13)])
def test_they_are_the_residual_of_the_equations(shape: tuple[int, int], weight: float) -> None:
    case = problem("ring", *shape)
    x, y, cells = bent(case)
    equations = case.equations(weight)
    expected = equations.residual(equations.vector(em.Mesh(x, y))).reshape(2, *shape)[:, 1:-1, 1:-1]
    found = np.empty_like(expected)
    per_spacing = (float((shape[0] - 1) ** 2), float((shape[1] - 1) ** 2))
    defects(x, y, cells, per_spacing, weight, found)
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-10 * np.abs(expected).max())


def test_the_directions_are_the_metric_times_the_edges() -> None:
    case = problem("ring", 7, 6)
    x, y, m = bent(case)
    found = np.empty((4, 5, 4))
    directions(x, y, m, found)
    i, j = 3, 2
    mean = m[:, i - 1 : i + 1, j - 1 : j + 1].mean(axis=(1, 2))
    tensor = np.array([[mean[0], mean[1]], [mean[1], mean[2]]])
    along_xi = 0.5 * np.array([x[i + 1, j] - x[i - 1, j], y[i + 1, j] - y[i - 1, j]])
    along_eta = 0.5 * np.array([x[i, j + 1] - x[i, j - 1], y[i, j + 1] - y[i, j - 1]])
    assert found[:2, i - 1, j - 1] == pytest.approx(tensor @ along_xi)
    assert found[2:, i - 1, j - 1] == pytest.approx(tensor @ along_eta)
