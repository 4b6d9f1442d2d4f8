"""Values at the nodes from averages over cells."""

from __future__ import annotations

import numpy as np

from equimesh_coupling.cells import CellAverages, cell_values
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, IntArray
from equimesh_coupling.patches import cells_near_nodes

# The least number of nodes on a side: a plane needs two rows of cells.
MIN_NODES = 3


def nodes_from_cells(averages: CellAverages, mesh: HasParts) -> Array:
    """The values at the nodes, shape ``(n_xi, n_eta)``, or ``(n,)`` on a mesh of blocks, from averages over the cells.

    At each node the plane is taken that fits the averages of the nearest quadrilaterals at their centroids best: two by
    two of a grid; of blocks those around the node, and at the boundary also their neighbours. So a linear function is
    recovered without error, and a smooth one to second order; between layers the values can exceed those of the cells.
    Two triangles that share a quadrilateral are averaged first.

    Raises :class:`BadValues` for another length, values that are not finite, and fewer than 3 nodes on a side.
    """
    values = cell_values(averages, mesh)
    parts = mesh.mesh_parts("quad")
    if parts.shape is not None and min(parts.shape) < MIN_NODES:
        raise BadValues(f"values at the nodes need at least {MIN_NODES} nodes on each side, not {parts.shape}")
    centres, flat = _centroids(parts.points[parts.cells]), values.reshape(-1)
    found = np.empty(len(parts.points))
    near = cells_near_nodes(parts.cells, len(found)) if parts.shape is None else _on_grid(parts.shape)
    for nodes, cells in near:
        found[nodes] = _planes(parts.points[nodes], centres[cells], flat[cells])
    return found.reshape(parts.node_shape)


def _planes(nodes: Array, centres: Array, values: Array) -> Array:
    """The values at the ``nodes`` of the planes that fit best.

    ``values`` of shape ``(k, c)`` are those at the ``centres`` of shape ``(k, c, 2)``.
    """
    around = centres - nodes[:, None, :]
    size = np.maximum(np.abs(around).max(axis=1, keepdims=True), np.finfo(float).tiny)
    planes = np.concatenate([np.ones((*around.shape[:2], 1)), around / size], axis=2)
    at_nodes = np.linalg.pinv(planes)[:, 0, :]  # the weights of the averages in the value of the plane at the node
    found: Array = (at_nodes * values).sum(axis=1)
    return found


def _on_grid(shape: tuple[int, int]) -> list[tuple[slice, IntArray]]:
    """All nodes of a grid, and the two by two cells that are nearest to each, shape ``(n, 4)``."""
    rows, columns = (_patches(n) for n in shape)
    near = rows[:, None, :, None] * (shape[1] - 1) + columns[None, :, None, :]
    return [(slice(None), near.reshape(-1, 4))]


def _patches(nodes: int) -> IntArray:
    """The two cells along one direction that are nearest to each node, shape ``(nodes, 2)``."""
    first = np.clip(np.arange(nodes) - 1, 0, nodes - 3)
    return np.stack([first, first + 1], axis=1)


def _centroids(corners: Array) -> Array:
    """The centroids of quadrilaterals with ``corners`` of shape ``(m, 4, 2)``, shape ``(m, 2)``."""
    a, b, c, d = corners[:, 0], corners[:, 1], corners[:, 2], corners[:, 3]
    first, second = _area(a, b, c), _area(a, c, d)
    weighted: Array = (first * (a + b + c) + second * (a + c + d)) / (3 * (first + second))
    return weighted


def _area(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of triangles."""
    ab, ac = b - a, c - a
    doubled: Array = ab[..., :1] * ac[..., 1:] - ab[..., 1:] * ac[..., :1]
    return doubled
