"""Values at the nodes from averages over cells."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import in_blocks, l_shape
from coupling.conftest import bent
from equimesh import Mesh
from equimesh_coupling import BadValues, CellAverages, MeshParts, node_values
from equimesh_coupling.recovery import cells_near_nodes, edge_numbers, nodes_from_cells, unique_edges


def centroids(mesh: Mesh, cells: str) -> np.ndarray:
    """The centroids of the cells, by a fan of triangles."""
    parts = mesh.mesh_parts(cells)  # type: ignore[arg-type]
    corners = parts.points[parts.cells]
    fans = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
    areas = np.stack([np.linalg.det(fan[:, 1:] - fan[:, :1]) for fan in fans])
    return (areas[..., None] * np.stack([fan.mean(axis=1) for fan in fans])).sum(axis=0) / areas.sum(axis=0)[:, None]


@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_a_linear_function_is_recovered_without_error(mesh: Mesh, cells: str) -> None:
    x, y = centroids(mesh, cells).T
    found = nodes_from_cells(CellAverages(2 + 3 * x - 5 * y), mesh)
    assert abs(found - (2 + 3 * mesh.x - 5 * mesh.y)).max() < 1e-12


def test_a_smooth_function_is_recovered_to_second_order() -> None:
    errors = []
    for n in (17, 33, 65):
        xi, eta = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
        mesh = Mesh(xi + 0.1 * np.sin(3 * eta), eta + 0.2 * xi**2)
        x, y = centroids(mesh, "quad").T
        errors.append(abs(nodes_from_cells(CellAverages(np.sin(3 * x) * y**2), mesh) - np.sin(3 * mesh.x) * mesh.y**2))
    largest = [error.max() for error in errors]
    assert largest[0] / largest[1] > 3.5
    assert largest[1] / largest[2] > 3.5
    assert largest[2] < 2e-3


def test_thin_cells_do_no_harm() -> None:
    s = np.linspace(0, 1, 9) ** 6
    mesh = Mesh(*np.meshgrid(s, s, indexing="ij"))
    x, y = centroids(mesh, "quad").T
    assert abs(nodes_from_cells(CellAverages(x - y), mesh) - (mesh.x - mesh.y)).max() < 1e-12


def test_two_rows_of_cells_are_needed() -> None:
    mesh = Mesh(*np.meshgrid([0.0, 1.0], [0.0, 0.5, 1.0], indexing="ij"))
    with pytest.raises(BadValues, match="at least 3 nodes on each side"):
        nodes_from_cells(CellAverages([1.0, 2.0]), mesh)


# Edges of a mesh, every one once.


def test_every_edge_is_there_once(parts: MeshParts) -> None:
    edges, of_cells = unique_edges(parts.cells)
    assert len(parts.points) - len(edges) + len(parts.cells) == 1  # Euler's formula
    assert len({frozenset(edge) for edge in edges.tolist()}) == len(edges)
    ahead = np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=2)
    assert np.array_equal(np.sort(edges[of_cells], axis=2), np.sort(ahead, axis=2))
    inner = np.bincount(of_cells.ravel())
    assert set(inner) == {1, 2}
    assert (inner == 1).sum() == sum(map(len, parts.sides.values()))


def test_an_edge_is_found_in_either_direction(parts: MeshParts) -> None:
    edges, _ = unique_edges(parts.cells)
    wanted = np.array([5, 0, 17])
    assert edge_numbers(edges[wanted], edges).tolist() == [5, 0, 17]
    assert edge_numbers(edges[wanted][:, ::-1], edges).tolist() == [5, 0, 17]


# The cells near each node of a mesh of blocks, and values at the nodes from averages over them.


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


def test_patches_recover_a_smooth_function_to_second_order() -> None:
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
