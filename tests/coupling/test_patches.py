"""The cells near each node of a mesh of blocks, and values at the nodes from averages over them."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import in_blocks, l_shape
from coupling.conftest import bent
from equimesh_coupling import BadValues, CellAverages, MeshParts, node_values
from equimesh_coupling.recovery import cells_near_nodes


def near(cells: np.ndarray, count: int) -> dict[int, set[int]]:
    return {
        node: {*found}
        for nodes, table in cells_near_nodes(cells, count)
        for node, found in zip(nodes.tolist(), table.tolist(), strict=True)
    }


def test_inner_nodes_have_the_cells_around_them_and_outer_ones_their_neighbours_too() -> None:
    mesh = l_shape(5)
    found = near(mesh.cells, 65)
    around = {node: {*np.flatnonzero((mesh.cells == node).any(axis=1)).tolist()} for node in range(65)}
    outer = {*np.concatenate([*mesh.sides.values()]).ravel().tolist()}
    for node in range(65):
        assert found[node] == around[node] if node not in outer else found[node] > around[node], node
    corner = int(mesh.blocks[0][0, 0])
    low = mesh.block_cells[0]
    assert found[corner] == {low[0, 0], low[1, 0], low[0, 1]}
    inward = int(mesh.blocks[0][-1, -1])  # the corner that points into the domain has three cells around it
    assert len(around[inward]) == 3
    assert len(found[inward]) == 3 + 6


def test_a_linear_function_is_recovered_from_its_averages() -> None:
    mesh = in_blocks(bent()).mesh
    parts = mesh.mesh_parts()
    x, y = parts.points[parts.mesh_parts("triangle").cells].mean(axis=1).T
    assert node_values(CellAverages(3 * x - y + 2), mesh) == pytest.approx(3 * mesh.x - mesh.y + 2)


def test_a_smooth_function_is_recovered_to_second_order() -> None:
    errors = []
    for n in (9, 17, 33):
        mesh = l_shape(n)
        x, y = mesh.points[mesh.cells].mean(axis=1).T
        found = node_values(CellAverages(np.sin(2 * x) * np.cos(y)), mesh)
        errors.append(np.abs(found - np.sin(2 * mesh.x) * np.cos(mesh.y)).max())
    assert errors[0] / errors[1] > 3.2
    assert errors[1] / errors[2] > 3.5
    assert errors[2] < 4e-3


def test_one_cell_gives_no_plane() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    one = MeshParts(points=points, cells=np.array([[0, 1, 2, 3]]), sides={}, shape=None)
    with pytest.raises(BadValues, match="node 0 has 1 cells near it"):
        node_values(CellAverages([1.0]), one)
