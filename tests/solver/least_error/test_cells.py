"""Cells as lists of nodes, of grids and of any mesh: their corners, the nodes' places in them, three nodes in a row."""

from __future__ import annotations

from weakref import ref

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid, cells_of_mesh
from equimesh.numerics.types import IntArray
from equimesh.testing.geometries import disc
from solver.bent import uniform

GRIDS = [em.Grid(n_xi=4, n_eta=4), em.Grid(n_xi=7, n_eta=5), em.Grid(n_xi=5, n_eta=12)]


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_cells_and_nodes_have_the_numbers_of_meshes(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    assert np.array_equal(cells.corners, em.Mesh.uniform(grid).cells)
    assert (cells.count, cells.nodes) == ((grid.n_xi - 1) * (grid.n_eta - 1), grid.points)


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_every_corner_is_a_place_of_its_node_exactly_once(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    assert sorted(cells.places) == list(range(4 * cells.count))
    for node in range(cells.nodes):
        places = cells.places[cells.starts[node] : cells.starts[node + 1]]
        assert (cells.corners.reshape(-1)[places] == node).all()


@pytest.mark.parametrize("size", [1, 5, 100])
def test_spans_of_a_group_have_no_common_node(size: int) -> None:
    cells = cells_of_grid((9, 8))
    groups = cells.apart(size)
    assert sorted(k for group in groups for span in group for k in range(*span)) == list(range(cells.count))
    assert len(groups) == {1: 4, 5: 3, 100: 1}[size]
    for group in groups:
        nodes = [np.unique(cells.corners[slice(*span)]) for span in group]
        assert len(np.unique(np.concatenate(nodes))) == sum(map(len, nodes))


def test_spans_that_all_have_one_node_in_common_are_groups_of_their_own() -> None:
    around = np.arange(1, 241).reshape(80, 3)
    star = np.column_stack([np.zeros(80, dtype=np.int64), around])  # as of a file whose cells are in no order
    cells = cells_of_mesh(star, np.ones((2, 241)), np.empty((0, 2), dtype=np.int64))
    assert cells.apart(1) == [[(k, k + 1)] for k in range(80)]


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_nodes_of_sides_stay_on_them_and_corners_stay(grid: em.Grid) -> None:
    s, t = uniform(grid)
    free = cells_of_grid(grid.shape).free
    assert np.array_equal(free[0] == 0, (s == 0) | (s == 1))
    assert np.array_equal(free[1] == 0, (t == 0) | (t == 1))
    assert set(np.unique(free)) == {0.0, 1.0}


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_triples_are_neighbours_in_a_line_and_every_inner_node_is_in_the_middle_of_two(grid: em.Grid) -> None:
    cells, mesh = cells_of_grid(grid.shape), uniform(grid)
    first, middle, last = mesh[:, cells.triples.T].transpose(1, 0, 2)
    assert np.abs(first + last - 2 * middle).max() < 1e-15
    assert np.abs(last - first).max(axis=0) == pytest.approx(
        np.where(last[0] > first[0], 2 / (grid.n_xi - 1), 2 / (grid.n_eta - 1))
    )
    s, t = mesh
    inner = ((s > 0) & (s < 1)).astype(int) + ((t > 0) & (t < 1))
    assert np.array_equal(np.bincount(cells.triples[:, 1], minlength=cells.nodes), inner)


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_stiffness_is_the_diagonal_of_the_sum_of_squared_second_differences(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    differences = np.zeros((len(cells.triples), cells.nodes))
    for column, weight in enumerate((1.0, -2.0, 1.0)):
        differences[np.arange(len(cells.triples)), cells.triples[:, column]] += weight
    assert np.array_equal(cells.stiffness, np.diag(differences.T @ differences))


def test_the_cells_of_a_grid_are_kept() -> None:
    assert cells_of_grid((6, 9)) is cells_of_grid((6, 9))


def test_of_large_grids_only_the_last_is_kept() -> None:
    first = cells_of_grid((131, 129))
    assert cells_of_grid((131, 129)) is first
    forgotten = ref(first)
    del first
    cells_of_grid((129, 131))
    assert forgotten() is None


# The cells of any mesh of quadrilaterals: those of a grid are as before, and lines end at singular nodes.

OPEN, CLOSED = (False, False), (False, True)


def as_set(triples: IntArray) -> set[tuple[int, ...]]:
    return {min(tuple(row), tuple(row[::-1])) for row in triples.tolist()}


@pytest.mark.parametrize("closed", [OPEN, CLOSED], ids=str)
def test_on_a_grid_they_are_those_of_the_grid(closed: tuple[bool, bool]) -> None:
    grid = cells_of_grid((5, 7), closed)
    cells = cells_of_mesh(grid.corners, grid.free, grid.ties)
    assert np.array_equal(cells.starts, grid.starts)
    assert np.array_equal(cells.places, grid.places)
    assert as_set(cells.triples) == as_set(grid.triples)
    assert len(cells.triples) == len(grid.triples)
    assert np.array_equal(cells.stiffness, grid.stiffness)


def test_lines_end_at_nodes_of_three_cells() -> None:
    mesh = disc(300).mesh
    cells = cells_of_mesh(mesh.cells, np.ones((2, len(mesh.points))), mesh.ties)
    used, middle = np.bincount(mesh.cells.ravel()), np.bincount(cells.triples[:, 1], minlength=len(mesh.points))
    assert (used == 3).sum() == 4
    assert (middle[used == 3] == 0).all()
    assert (middle[used == 4] == 2).all()
    assert (middle[used == 2] == 1).all()


def test_cuts_through_corners_are_found_on_request() -> None:
    grid = cells_of_grid((5, 7))
    assert cells_of_mesh(grid.corners, grid.free, grid.ties, are_cut=True).corner_cuts == grid.corner_cuts
    assert cells_of_mesh(grid.corners, grid.free, grid.ties).corner_cuts == {}
