"""The rows of a mesh that a process holds to measure its cells."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_part import cut
from equimesh.meshes.mesh_window import MeshWindow, WindowCells, WindowRows
from equimesh.numerics.channel import Channel, ThreadChannels

MESH = Mesh.uniform(Grid(n_xi=1400, n_eta=90))


def windows(cuts: list[int]) -> list[MeshWindow]:
    parts = cut(MESH, cuts)

    def work(channel: Channel) -> MeshWindow:
        return MeshWindow.of_part(parts[channel.number], channel)

    return ThreadChannels(len(parts)).run(work)


@pytest.mark.parametrize("cuts", [[], [500], [1, 2, 1399], [365, 366]])
def test_a_window_holds_the_cells_of_its_part_and_the_rows_next_to_them(cuts: list[int]) -> None:
    found = windows(cuts)
    assert [window.rows.last for window in found] == [*cuts, 1399]
    for window, first in zip(found, [0, *cuts], strict=True):
        rows = window.rows
        assert (rows.first, rows.begin) == (first, max(first - 1, 0))
        end = min(rows.last + 2, 1400) if rows.last > rows.first else 1400
        assert np.array_equal(window.x, MESH.x[rows.begin : end])
        assert np.array_equal(window.y, MESH.y[rows.begin : end])
        assert window.grid == MESH.grid


def test_strips_of_all_parts_are_those_of_the_whole_where_it_is_cut_between_them() -> None:
    whole = WindowRows.whole(MESH.x.shape)
    assert len(whole.strips) == 4
    assert whole.strips[0][0] == 0
    assert whole.strips[-1][1] == 1399
    cuts = [first for first, _ in whole.strips[1:]]
    assert [strip for window in windows(cuts[::2]) for strip in window.rows.strips] == list(whole.strips)
    inside = [strip for window in windows([700]) for strip in window.rows.strips]
    assert [first for first, _ in inside] == sorted({0, *cuts, 700})


def test_sums_over_cells_do_not_depend_on_the_parts() -> None:
    rows = WindowRows.whole(MESH.x.shape)
    values = np.random.default_rng(1).random((2, 1399 * 89))
    numbers = np.flatnonzero(values[0] < 0.3)
    cells = WindowCells.of(rows, numbers)
    expected = cells.total(values[:, numbers])
    assert expected == pytest.approx(values[:, numbers].sum(axis=1), rel=1e-13)
    parts = cut(MESH, [first for first, _ in rows.strips[1:]])

    def work(channel: Channel) -> tuple[list[float], int, int]:
        own = MeshWindow.of_part(parts[channel.number], channel).rows
        here = numbers[(numbers >= own.own.start) & (numbers < own.own.stop)]
        chosen = WindowCells.of(own, here)
        assert WindowCells.of(own).numbers.tolist() == list(range(own.own.start, own.own.stop))
        return chosen.total(values[:, here]).tolist(), chosen.count(), chosen.repeated(2).count()

    for total, count, twice in ThreadChannels(len(parts)).run(work):
        assert total == expected.tolist()
        assert (count, twice) == (numbers.size, 2 * numbers.size)


def test_the_uniform_mesh_is_known_by_rows() -> None:
    rows = WindowRows(shape=MESH.x.shape, begin=3, first=4, last=8)
    window = MeshWindow.uniform(rows, 7)
    assert np.array_equal(window.x, MESH.x[3:10])
    assert np.array_equal(window.nodes(4, 8)[1], MESH.y[4:9])
