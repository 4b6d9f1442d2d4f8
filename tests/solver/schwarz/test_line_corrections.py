"""Line corrections of the merged mesh: they shrink its error, know how much is left, and fold nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz import line_corrections
from equimesh.schwarz.decomposition import SubdomainWindow
from equimesh.schwarz.line_corrections import LineCorrections, WholeLineSums, interfaces
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.optimized import EdgeSlopes
from equimesh_cluster.messages import Channel, ThreadChannels
from equimesh_cluster.parts.holding import OnChannel
from solver.schwarz.bent import bent
from solver.schwarz.test_segments import edge_lengths

CASE = problem("tanh20", 25, 21)
SOLUTION = em.solve(CASE, mode=em.Mode.TIGHT).reference


def disturbed(size: float) -> em.Mesh:
    bump = size * np.sin(np.pi * SOLUTION.x) * np.sin(np.pi * SOLUTION.y)
    return em.Mesh(SOLUTION.x + bump, SOLUTION.y - bump)


def error(mesh: em.Mesh) -> float:
    return float(max(abs(mesh.x - SOLUTION.x).max(), abs(mesh.y - SOLUTION.y).max()))


def test_corrections_lead_to_the_single_domain_solution() -> None:
    errors = [error(LineCorrections(CASE, 1).apply(disturbed(0.01), count).mesh) for count in (1, 3, 6)]
    assert errors[0] < 0.6 * error(disturbed(0.01))
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


@pytest.mark.parametrize("count", [4, 8])
def test_the_estimate_is_no_less_than_the_error(count: int) -> None:
    found = LineCorrections(CASE, 1).apply(disturbed(0.01), count)
    assert found.count == count
    assert 0.3 * error(found.mesh) < found.estimate < 30 * error(found.mesh)
    assert 0.0 < found.deviation < 0.1


def test_they_end_where_the_error_left_is_small_enough() -> None:
    found = LineCorrections(CASE, 1).apply(disturbed(0.01), 50, enough=1e-4)
    assert 1 < found.count < 50
    assert found.estimate <= 1e-4
    assert error(found.mesh) < 1e-3


def test_none_of_them_leaves_the_mesh_as_it_was() -> None:
    start = disturbed(0.01)
    found = LineCorrections(CASE, 1).apply(em.Mesh(start.x.copy(), start.y.copy()), 0)
    assert np.array_equal(found.mesh.x, start.x)
    assert found.count == 0
    assert math.isnan(found.estimate)
    assert math.isnan(found.deviation)


def test_a_correction_that_would_fold_is_not_taken() -> None:
    steep = problem("tanh20", 33, a=1.0, b=0.0)
    start = em.Mesh.uniform(steep.grid)
    found = LineCorrections(steep, 1).apply(em.Mesh(start.x.copy(), start.y.copy()), 20)
    assert found.count < 20
    assert not found.mesh.is_folded


# Sums of squared metric lengths beyond interfaces: as neighbours pass them on, and in one process.


SHAPE = (23, 17)


@pytest.mark.parametrize("rows", [64, 5])
def test_they_are_the_sums_of_the_edges(rows: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_corrections, "MAX_ROWS", rows)
    case = problem("ring", *SHAPE)
    mesh = bent(case, 0.01)
    along_xi, along_eta = edge_lengths(case, mesh)
    sums = WholeLineSums(case, ({4, 9}, {6}), 2)
    sums.read(mesh)
    for point in (4, 9):
        assert sums.beyond_point(0, 0, point) == pytest.approx(along_xi[:point].sum(axis=0))
        assert sums.beyond_point(0, 1, point) == pytest.approx(along_xi[point:].sum(axis=0))
    assert sums.beyond_point(1, 0, 6) == pytest.approx(along_eta[:, :6].sum(axis=1))
    assert sums.beyond_point(1, 1, 6) == pytest.approx(along_eta[:, 6:].sum(axis=1))


@pytest.mark.parametrize(("subdomains", "parts"), [((3, 1), 3), ((3, 2), 2), ((2, 3), 6)], ids=str)
@pytest.mark.parametrize("boundary", em.Boundary)
def test_neighbours_pass_on_the_same_sums_to_the_last_bit(
    subdomains: tuple[int, int], parts: int, boundary: em.Boundary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(line_corrections, "MAX_ROWS", 5)
    case = problem("ring", *SHAPE, boundary=boundary)
    decomposition = em.Decomposition(grid=case.grid, subdomains=subdomains, overlap=3)
    windows = [SubdomainWindow(decomposition, part, 1) for part in decomposition.parts]
    mesh = bent(case, 0.01)
    whole = MergedMeshes(decomposition).line_sums(case, windows, 1)
    whole.read(mesh)
    assert interfaces(decomposition)[0] == {
        end for part in decomposition.parts for end in (part.columns[0], part.columns[-1])
    }

    def compare(channel: Channel) -> int:
        holding, compared = OnChannel(channel, decomposition), 0
        held = holding.line_sums(case, windows, 1)
        held.read(holding.cut(mesh))
        for window in (windows[k] for k in holding.numbers):
            for (axis, end), is_open in window.open.items():
                if not is_open:
                    continue
                inside = slice(int(window.open[1 - axis, 0]), window.shape[1 - axis] - int(window.open[1 - axis, 1]))
                pairs = [(held.beyond(window, axis, end)[inside], whole.beyond(window, axis, end)[inside])]
                for along in (0, 1):
                    if not window.open[1 - axis, along]:
                        pairs.append(
                            (held.side_edges(window, axis, end, along), whole.side_edges(window, axis, end, along))
                        )
                assert all(np.array_equal(*pair) for pair in pairs)
                compared += len(pairs)
        return compared

    assert sum(ThreadChannels(parts).run(compare)) > 4


def test_local_data_needs_no_sums() -> None:
    case = problem("ring", *SHAPE)
    decomposition = em.Decomposition(grid=case.grid, subdomains=(2, 1), overlap=3)
    windows = [SubdomainWindow(decomposition, part, 1) for part in decomposition.parts]

    def sent(channel: Channel) -> dict[str, int]:
        holding = OnChannel(channel, decomposition)
        sums = holding.line_sums(case, windows, 1, local=True)
        sums.read(holding.cut(em.Mesh.uniform(case.grid)))
        assert not sums.beyond(windows[channel.number], 0, 1 - channel.number).any()
        return holding.sent

    assert ThreadChannels(2).run(sent) == [{}, {}]


# How metric lengths of edges change with the merged mesh, against difference quotients.


@pytest.mark.parametrize("boundary", [em.Boundary.TRACE, em.Boundary.EQUIDISTRIBUTED_1D])
def test_edge_slopes_add_up_to_those_of_the_sums(boundary: em.Boundary) -> None:
    case = problem("paper", 11, 9, boundary=boundary)
    mesh = bent(case, 0.01)
    change = np.sin(3 * mesh.x + mesh.y), np.cos(2 * mesh.y - mesh.x)
    for q, fixed in zip(change, ((0, slice(None)), (slice(None), 0)), strict=True):
        q[fixed] = q[tuple(-1 if part == 0 else part for part in fixed)] = 0.0  # nodes stay on their sides
    along_xi, along_eta = EdgeSlopes(case, mesh).along(change)
    h, found = 1e-6, []
    for step in (h, -h):
        sums = WholeLineSums(case, ({4}, {3}))
        sums.read(em.Mesh(mesh.x + step * change[0], mesh.y + step * change[1]))
        found.append([sums.beyond_point(axis, end, (4, 3)[axis]) for axis in (0, 1) for end in (0, 1)])
    expected = [(ahead - behind) / (2 * h) for ahead, behind in zip(*found, strict=True)]
    slopes = [along_xi[:4].sum(axis=0), along_xi[4:].sum(axis=0), along_eta[:, :3].sum(axis=1)]
    slopes.append(along_eta[:, 3:].sum(axis=1))
    for slope, quotient in zip(slopes, expected, strict=True):
        assert abs(slope).max() > 1e-2
        assert slope == pytest.approx(quotient, abs=1e-6)
