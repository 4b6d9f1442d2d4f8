"""Compiled loops, each against the formula that it writes out."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import Cells, SeenGradient
from equimesh.meshes.rows import Rows
from equimesh.sweeps import kernels
from equimesh.sweeps.kernels import Lines, Moved, Nodes
from equimesh.sweeps.line_sums import LineSums, cell_metrics
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
