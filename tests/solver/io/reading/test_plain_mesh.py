"""A mesh as a file holds it: points that no cell uses go, and other faults are named."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh, refuse_cell
from solver.io.reading.plain import small

POINTS = np.array([[9.0, 9], [0, 0], [1, 0], [7, 7], [1, 1], [0, 1]])
CELLS = np.array([[1, 2, 4, 5]])


def test_points_that_no_cell_uses_are_left_out() -> None:
    mesh = PlainMesh.of(POINTS, CELLS, {"low": np.array([[1, 2]])}, {"te": 4, "centre": 3})
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert mesh.cells.tolist() == [[0, 1, 2, 3]]
    assert mesh.sides["low"].tolist() == [[0, 1]]
    assert mesh.places == {"te": 2}


def test_a_third_coordinate_must_be_constant_where_it_is_used() -> None:
    space = np.pad(POINTS, ((0, 0), (0, 1)), constant_values=2.0)
    space[0, 2] = 5.0
    assert PlainMesh.of(space, CELLS, {}).points.shape == (4, 2)
    space[2, 2] = 2.5
    with pytest.raises(InputError, match=r"node 2 has z = 2.5, node 1 has z = 2;"):
        PlainMesh.of(space, CELLS, {})


def test_faults_are_named() -> None:
    with pytest.raises(InputError, match="no quadrilaterals"):
        PlainMesh.of(POINTS, np.empty((0, 4), int), {})
    with pytest.raises(InputError, match=r"the cells: number 0 has the nodes \[1, 2, 4, 6\], but the file has 6 nodes"):
        PlainMesh.of(POINTS, np.array([[1, 2, 4, 6]]), {})
    with pytest.raises(InputError, match=r"the side 'low' has the edge \[1, 3\] of nodes that no cell has"):
        PlainMesh.of(POINTS, CELLS, {"low": np.array([[1, 3]])})
    bad = POINTS.copy()
    bad[4, 1] = np.inf
    with pytest.raises(InputError, match=r"node 4 has the coordinates \[1.0, inf\]"):
        PlainMesh.of(bad, CELLS, {})


def test_the_place_of_another_cell_is_named_where_it_is_known() -> None:
    assert (
        "cell 3 of the file near (0.5, 0) is a triangle" in refuse_cell("triangle", 3, POINTS, np.array([1, 2])).message
    )
    assert "cell 3 of the file is a triangle" in refuse_cell("triangle", 3, POINTS, np.array([-1, 99])).message


def test_too_many_sides_are_refused() -> None:
    mesh = small()
    sides = {f"s{k}": mesh.cells[:1, :2] for k in range(1001)}
    with pytest.raises(InputError, match="there are 1001 named sides: 1000 are possible"):
        PlainMesh.of(mesh.points, mesh.cells, sides)


def test_cells_and_edges_that_are_there_often_are_refused() -> None:
    with pytest.raises(InputError, match="the file has 5 cells of 4 nodes: some lie on each other"):
        PlainMesh.of(POINTS, np.repeat(CELLS, 5, axis=0), {})
    with pytest.raises(InputError, match="the sides have 42 edges, the mesh 1 cells: name each edge once"):
        PlainMesh.of(POINTS, CELLS, {name: np.repeat(CELLS[:, :2], 21, axis=0) for name in "ab"})
