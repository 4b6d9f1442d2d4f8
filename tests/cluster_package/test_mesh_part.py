"""Rows of a mesh as parts of it."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh, MeshWindow, Rows, WindowCells
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh_cluster.mesh_part import MeshPart, cut, window_of

MESH = Mesh.uniform(Grid(n_xi=9, n_eta=5))
LARGE = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


def test_parts_together_are_the_mesh() -> None:
    parts = cut(MESH, [2, 3, 7])
    assert [part.number for part in parts] == [0, 1, 2, 3]
    assert all(part.count == 4 and part.grid == MESH.grid for part in parts)
    assert np.array_equal(np.concatenate([part.x[part.own_rows] for part in parts]), MESH.x)
    assert np.array_equal(np.concatenate([part.y[part.own_rows] for part in parts]), MESH.y)
    assert sum(part.last - part.first for part in parts) == MESH.grid.n_xi
    assert [part.is_last for part in parts] == [False, False, False, True]


def test_every_cell_belongs_to_one_part() -> None:
    parts = cut(MESH, [1, 6])
    assert np.array_equal(np.concatenate([part.first_node + part.cells for part in parts]), MESH.cells)
    assert [part.cell_rows for part in parts] == [(0, 1), (1, 6), (6, 8)]


def test_a_mesh_without_cuts_is_one_part() -> None:
    (part,) = cut(MESH, [])
    assert (part.first, part.last, part.is_last) == (0, 9, True)
    assert part.x.shape == (9, 5)


@pytest.mark.parametrize("cuts", [[0], [4, 4], [5, 3], [9], [12]])
def test_cuts_that_leave_a_part_without_rows_are_refused(cuts: list[int]) -> None:
    with pytest.raises(InputError, match="are not rows of a grid"):
        cut(MESH, cuts)


def test_a_part_without_the_first_row_of_the_next_one_is_refused() -> None:
    with pytest.raises(InputError, match=r"need the shape \(4, 5\)"):
        MeshPart(grid=MESH.grid, number=0, count=2, first=0, last=3, x=MESH.x[:3], y=MESH.y[:3])


def windows(cuts: list[int]) -> list[MeshWindow]:
    parts = cut(LARGE, cuts)

    def work(channel: Channel) -> MeshWindow:
        return window_of(parts[channel.number], channel)

    return ThreadChannels(len(parts)).run(work)


@pytest.mark.parametrize("cuts", [[], [500], [1, 2, 1399], [365, 366]])
def test_a_window_holds_the_cells_of_its_part_and_the_rows_next_to_them(cuts: list[int]) -> None:
    found = windows(cuts)
    assert [window.rows.last for window in found] == [*cuts, 1399]
    for window, first in zip(found, [0, *cuts], strict=True):
        rows = window.rows
        assert (rows.first, rows.begin) == (first, max(first - 1, 0))
        end = min(rows.last + 2, 1400) if rows.last > rows.first else 1400
        assert np.array_equal(window.x, LARGE.x[rows.begin : end])
        assert np.array_equal(window.y, LARGE.y[rows.begin : end])
        assert window.grid == LARGE.grid


def test_strips_of_all_parts_are_those_of_the_whole_where_it_is_cut_between_them() -> None:
    whole = Rows.whole(LARGE.x.shape)
    assert len(whole.strips) == 4
    assert whole.strips[0][0] == 0
    assert whole.strips[-1][1] == 1399
    cuts = [first for first, _ in whole.strips[1:]]
    assert [strip for window in windows(cuts[::2]) for strip in window.rows.strips] == list(whole.strips)
    inside = [strip for window in windows([700]) for strip in window.rows.strips]
    assert [first for first, _ in inside] == sorted({0, *cuts, 700})


def test_sums_over_cells_do_not_depend_on_the_parts() -> None:
    rows = Rows.whole(LARGE.x.shape)
    values = np.random.default_rng(1).random((2, 1399 * 89))
    numbers = np.flatnonzero(values[0] < 0.3)
    cells = WindowCells.of(rows, numbers)
    expected = cells.total(values[:, numbers])
    assert expected == pytest.approx(values[:, numbers].sum(axis=1), rel=1e-13)
    parts = cut(LARGE, [first for first, _ in rows.strips[1:]])

    def work(channel: Channel) -> tuple[list[float], int, int]:
        own = window_of(parts[channel.number], channel).rows
        here = numbers[(numbers >= own.own.start) & (numbers < own.own.stop)]
        chosen = WindowCells.of(own, here)
        assert WindowCells.of(own).numbers.tolist() == list(range(own.own.start, own.own.stop))
        return chosen.total(values[:, here]).tolist(), chosen.count(), chosen.repeated(2).count()

    for total, count, twice in ThreadChannels(len(parts)).run(work):
        assert total == expected.tolist()
        assert (count, twice) == (numbers.size, 2 * numbers.size)
