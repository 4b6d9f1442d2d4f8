"""Cells as lists of nodes: their corners, the nodes' places in them, and three nodes in a row."""

from __future__ import annotations

from weakref import ref

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
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
