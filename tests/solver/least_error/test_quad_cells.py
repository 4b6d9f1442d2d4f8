"""The cells of any mesh of quadrilaterals: those of a grid are as before, and lines end at singular nodes."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.least_error.cells import cells_of_grid, cells_of_mesh
from equimesh.numerics.types import IntArray
from equimesh.testing.geometries import disc

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
