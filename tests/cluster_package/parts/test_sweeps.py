"""Sweeps of several processes: sums along lines, sides and rows are those of the whole grid, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.rows import Rows
from equimesh.sweeps.kernels import Lines
from equimesh.sweeps.line_sums import LineSums
from equimesh.sweeps.sweep import SideNodes
from equimesh_cluster.messages import Channel, Counted, ThreadChannels, Traffic
from equimesh_cluster.parts.rows import PartRows, cuts_of, row_cuts
from equimesh_cluster.parts.sweeps import PartLineSums, with_rows

SHAPE = (1030, 2100)  # 65 strips
STRIPS = np.random.default_rng(7).random((65, SHAPE[1]))
FIRST, LEFT, RIGHT = np.random.default_rng(8).random((3, SHAPE[1]))
ENDS = SHAPE[0] - 1
NONE = np.zeros((2, SHAPE[1]))
LINES = Lines(0, ENDS, NONE, (0.0, 0.0), NONE)


def solved(channel: Channel) -> tuple[LineSums, float, dict[str, Traffic]]:
    counted = Counted(channel)
    sums = PartLineSums(PartRows.of(SHAPE, 1, counted), ENDS)
    first, last = cuts_of(len(STRIPS), channel.count)[channel.number : channel.number + 2]
    sums.strips[:] = STRIPS[first:last]
    if channel.number == 0:
        sums.first[:], sums.pushes[0] = FIRST, LEFT
    if channel.number == channel.count - 1:
        sums.pushes[1] = RIGHT
    return sums, sums.solve(LINES), counted.taken()


def whole_sums() -> tuple[LineSums, float]:
    """The sums of all rows in one process."""
    sums = LineSums(Rows.whole(SHAPE), ENDS)
    sums.strips[:], sums.first[:], sums.pushes[:] = STRIPS, FIRST, (LEFT, RIGHT)
    return sums, sums.solve(LINES)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7, 8, 16])
def test_parts_find_the_same_to_the_last_bit(count: int) -> None:
    whole, deviation = whole_sums()
    found = ThreadChannels(count).run(solved)
    starts = np.concatenate([sums.starts for sums, _, _ in found])
    assert np.array_equal(starts[:, 1:-1], whole.starts[:, 1:-1])
    for sums, _, _ in found:
        assert all(np.array_equal(one, other) for one, other in zip(sums.levels, whole.levels, strict=True))
    assert [own for _, own, _ in found] == [deviation] + (count - 1) * [0.0]


@pytest.mark.parametrize("count", [2, 4, 8, 16])
def test_sums_go_up_and_starts_down_once_for_every_cut(count: int) -> None:
    sent = [traffic for _, _, traffic in ThreadChannels(count).run(solved)]
    row = 8 * SHAPE[1]
    totals = {tag: [sum(one[tag].bytes for one in sent if tag in one)] for tag in ("sums", "starts", "push")}
    assert totals == {"sums": [row * (count - 1)], "starts": [3 * row * (count - 1)], "push": [row]}
    most = max(sum(traffic.messages for traffic in one.values()) for one in sent)
    assert most <= count.bit_length() + 1, "the logarithm of the number of parts"


# The nodes along the sides, in full, and rows that other processes own.


SIDES = (130, 2049)
X, Y = np.random.default_rng(5).random((2, *SIDES))


def test_every_part_gets_all_sides() -> None:
    def work(channel: Channel) -> SideNodes:
        rows = PartRows.of(SIDES, 1, channel)
        return SideNodes.of_rows(X[rows.here], Y[rows.here], rows)

    whole = SideNodes.of(X, Y)
    assert np.array_equal(whole.along_eta, Y[[0, -1]])
    assert np.array_equal(whole.along_xi, X[:, [0, -1]].T)
    for count in (1, 2, 3, 5):
        for found in ThreadChannels(count).run(work):
            assert all(np.array_equal(one, other) for one, other in zip(found, whole, strict=True))


@pytest.mark.parametrize("wanted", [[(0, 30), (40, 80), (70, 130)], [(0, 130)] * 3, [(60, 120), (0, 70), (1, 2)]])
def test_a_part_gets_the_rows_that_it_wants_from_their_owners(wanted: list[tuple[int, int]]) -> None:
    mesh = Mesh.uniform(Grid(n_xi=130, n_eta=2049))
    cuts = row_cuts(mesh.grid.shape, 3)

    def work(channel: Channel) -> MeshRows:
        rows = PartRows.of(mesh.grid.shape, 1, channel)
        return with_rows(MeshRows(mesh.x[rows.here], mesh.y[rows.here], rows), wanted, channel)

    for number, found in enumerate(ThreadChannels(3).run(work)):
        assert found.rows.begin == min(wanted[number][0], cuts[number])
        assert found.rows.end == max(wanted[number][1], cuts[number + 1])
        assert np.array_equal(found.x, mesh.x[found.rows.here])
        assert np.array_equal(found.y, mesh.y[found.rows.here])
