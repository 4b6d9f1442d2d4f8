"""Sums at the nodes and corners of blocks, with tied nodes as one."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.transfers.integrals import QuadCells, cells_of, untied
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import disc, strip


def test_a_grid_has_the_same_numbers_as_blocks() -> None:
    grid = smooth_mesh(7)
    one, other = cells_of(grid), QuadCells.of(QuadMesh(points=grid.points, cells=grid.cells, sides=grid.sides))
    nodal = np.sin(grid.x).reshape(-1)
    assert np.array_equal(one.area, other.area)
    assert np.array_equal(one.at_corners(nodal), other.at_corners(nodal))
    assert np.abs(one.at_nodes(one.weights) - other.node_weights).max() < 1e-16
    for extreme in (np.minimum, np.maximum):
        assert np.array_equal(one.around_nodes(one.area, extreme).reshape(-1), other.around_nodes(other.area, extreme))
    assert (other.shape, other.nodes) == ((one.area.size,), (nodal.size,))


def test_tied_nodes_are_one_node() -> None:
    mesh = strip(4)
    cells = QuadCells.of(mesh)
    assert cells.nodes == (20,)
    assert cells.node_weights.sum() == pytest.approx(1.0)
    assert np.allclose(cells.node_weights.reshape(4, 5)[:, 2], 1 / 16)
    assert np.all(cells.links.neighbours.reshape(4, 4, 4)[:, 1:-1] >= 0)
    assert untied(disc(2))[0].size == len(disc(2).points)


def test_a_copy_of_a_copy_is_the_same_node() -> None:
    mesh = strip(3, both=True)
    kept, number = untied(mesh)
    assert kept.size == 9
    assert number[[0, 3, 12, 15]].tolist() == [0, 0, 0, 0]
