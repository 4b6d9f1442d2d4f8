"""Sums of squared metric lengths beyond interfaces: as neighbours pass them on, and in one process."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh.schwarz import line_corrections
from equimesh.schwarz.decomposition import SubdomainWindow
from equimesh.schwarz.line_corrections import WholeLineSums, interfaces, line_sums
from equimesh.schwarz.merged_mesh import InOneProcess
from equimesh_cluster.parts.holding import OnChannel
from solver.schwarz.bent import bent
from solver.schwarz.test_segments import edge_lengths

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
    whole = line_sums(case, InOneProcess(decomposition), windows, 1)
    whole.read(mesh)
    assert interfaces(decomposition)[0] == {
        end for part in decomposition.parts for end in (part.columns[0], part.columns[-1])
    }

    def compare(channel: Channel) -> int:
        holding, compared = OnChannel(channel, decomposition), 0
        held = line_sums(case, holding, windows, 1)
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
        sums = line_sums(case, holding, windows, 1, local=True)
        sums.read(holding.cut(em.Mesh.uniform(case.grid)))
        assert not sums.beyond(windows[channel.number], 0, 1 - channel.number).any()
        return holding.sent

    assert ThreadChannels(2).run(sent) == [{}, {}]
