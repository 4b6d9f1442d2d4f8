"""The rows of a grid in one of several processes: cuts, sweeps and sums are those of the whole grid, bit by bit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.rows import Node, Rows
from equimesh.numerics.types import Array
from equimesh.quality.cells import ChosenCells
from equimesh.sweeps.kernels import Lines
from equimesh.sweeps.line_sums import LineSums
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.messages import ALONE, Channel, Counted, ThreadChannels, Traffic
from equimesh_cluster.parts.rows import PartRows, cuts_of, nodes_across, nodes_inside, rows_of_part
from equimesh_cluster.parts.sweeps import PartLineSums

LARGE = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


@pytest.mark.parametrize("strips", [8, 33, 64, 128])
@pytest.mark.parametrize("parts", [1, 2, 3, 4, 5, 6, 7, 8])
def test_parts_are_cut_at_nodes_and_nearly_equal(strips: int, parts: int) -> None:
    cuts = cuts_of(strips, parts)
    sizes = [last - first for first, last in pairwise(cuts)]
    assert (cuts[0], cuts[-1], len(cuts)) == (0, strips, parts + 1)
    assert min(sizes) >= 1
    assert max(sizes) <= 1.25 * strips / parts + 1
    for first, last in pairwise(cuts):
        inside = nodes_inside(strips, first, last)
        assert [k for node in inside for k in range(node.first, node.last)] == list(range(first, last))
        assert len(inside) == 1 or parts & (parts - 1), "parts of a power of two are nodes"
        assert len(inside) <= 8


def test_a_node_across_parts_comes_before_those_inside_it() -> None:
    assert nodes_across(8, (0, 4, 8)) == (Node(0, 4, 8),)
    assert nodes_across(8, (0, 3, 8)) == (Node(0, 4, 8), Node(0, 2, 4), Node(2, 3, 4))
    assert nodes_across(8, (0, 8)) == ()


def test_more_parts_than_strips_are_refused() -> None:
    assert cuts_of(5, 5) == (0, 1, 2, 3, 4, 5)
    with pytest.raises(InputError, match="at most 5 parts, not 6"):
        cuts_of(5, 6)


# The rows of a part, with those next to them.


def rows_of_parts(cuts: list[int]) -> list[MeshRows]:
    parts = cut(LARGE, cuts)

    def work(channel: Channel) -> MeshRows:
        return rows_of_part(parts[channel.number], channel)

    return ThreadChannels(len(parts)).run(work)


@pytest.mark.parametrize("cuts", [[], [500], [1, 2, 1399], [365, 366]])
def test_a_part_gets_the_rows_next_to_its_cells(cuts: list[int]) -> None:
    found = rows_of_parts(cuts)
    assert [here.rows.last for here in found] == [*cuts, 1399]
    for here, first in zip(found, [0, *cuts], strict=True):
        rows = here.rows
        assert (rows.first, rows.begin) == (first, max(first - 1, 0))
        end = min(rows.last + 2, 1400) if rows.last > rows.first else 1400
        assert rows.end == end
        assert np.array_equal(here.x, LARGE.x[rows.begin : end])
        assert np.array_equal(here.y, LARGE.y[rows.begin : end])
        assert here.grid == LARGE.grid


def test_sums_over_cells_do_not_depend_on_the_parts() -> None:
    rows = Rows.whole(LARGE.x.shape)
    values = np.random.default_rng(1).random((2, 1399 * 89))
    numbers = np.flatnonzero(values[0] < 0.3)
    cells = ChosenCells.of(rows, numbers)
    expected = cells.total(values[:, numbers])
    assert expected == pytest.approx(values[:, numbers].sum(axis=1), rel=1e-13)
    parts = cut(LARGE, [first for first, _ in rows.strips[1:]])

    def work(channel: Channel) -> tuple[list[float], int, int]:
        own = rows_of_part(parts[channel.number], channel).rows
        here = numbers[(numbers >= own.own.start) & (numbers < own.own.stop)]
        chosen = ChosenCells.of(own, here)
        assert ChosenCells.of(own).numbers.tolist() == list(range(own.own.start, own.own.stop))
        return chosen.total(values[:, here]).tolist(), chosen.count(), chosen.repeated(2).count()

    for total, count, twice in ThreadChannels(len(parts)).run(work):
        assert total == expected.tolist()
        assert (count, twice) == (numbers.size, 2 * numbers.size)


# Sums and extremes along lines: of the whole, to the last bit, in one message of each.


STRIPS = np.random.default_rng(5).standard_normal((11, 3, 40))


def over_lines(channel: Channel, strips: Array) -> Array | None:
    rows = PartRows(shape=(9, 9), begin=0, end=9, first=0, last=8, channel=channel)
    return rows.over_lines(strips)


@pytest.mark.parametrize("cuts", [[5], [1, 2], [2, 5, 8], [3, 4, 6, 9], [1, 2, 3, 4, 5, 6, 7]])
def test_processes_find_the_numbers_of_one(cuts: list[int]) -> None:
    whole = over_lines(ALONE, STRIPS)
    assert whole[0] == pytest.approx(STRIPS[:, 0].sum(axis=0), rel=1e-12)
    assert np.array_equal(whole[1], STRIPS[:, 1].max(axis=0))
    assert np.array_equal(whole[2], STRIPS[:, 2].min(axis=0))
    pieces = np.split(STRIPS, cuts)

    def work(channel: Channel) -> tuple[Array | None, int, int]:
        counted = Counted(channel)
        found = over_lines(counted, pieces[channel.number])
        return found, counted.sent["lines"].messages, counted.sent["lines"].bytes

    (first, *traffic), *others = ThreadChannels(len(pieces)).run(work)
    assert np.array_equal(first, whole)
    assert traffic == [0, 0]
    for found, messages, size in others:
        assert found is None
        assert messages == 1
        assert size <= 8 * 40 * (2 + 4)


SHAPE = (1030, 2100)  # 65 strips
SWEPT = np.random.default_rng(7).random((65, SHAPE[1]))
FIRST, LEFT, RIGHT = np.random.default_rng(8).random((3, SHAPE[1]))
ENDS = SHAPE[0] - 1
NONE = np.zeros((2, SHAPE[1]))
LINES = Lines(0, ENDS, NONE, (0.0, 0.0), NONE)


def solved(channel: Channel) -> tuple[LineSums, float, dict[str, Traffic]]:
    counted = Counted(channel)
    sums = PartLineSums(PartRows.of(SHAPE, 1, counted), ENDS)
    first, last = cuts_of(len(SWEPT), channel.count)[channel.number : channel.number + 2]
    sums.strips[:] = SWEPT[first:last]
    if channel.number == 0:
        sums.first[:], sums.pushes[0] = FIRST, LEFT
    if channel.number == channel.count - 1:
        sums.pushes[1] = RIGHT
    return sums, sums.solve(LINES), counted.taken()


def whole_sums() -> tuple[LineSums, float]:
    """The sums of all rows in one process."""
    sums = LineSums(Rows.whole(SHAPE), ENDS)
    sums.strips[:], sums.first[:], sums.pushes[:] = SWEPT, FIRST, (LEFT, RIGHT)
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
