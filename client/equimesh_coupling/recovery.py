"""Values at the nodes from averages over cells."""

from __future__ import annotations

import numpy as np

from equimesh_coupling.cells import CellAverages, cell_values
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, IntArray

# The least number of nodes on a side: a plane needs two rows of cells.
MIN_NODES = 3


def nodes_from_cells(averages: CellAverages, mesh: HasParts) -> Array:
    """The values at the nodes, shape ``(n_xi, n_eta)``, from averages over the cells.

    At each node the plane is taken that fits the averages of the two by two nearest quadrilaterals at their centroids
    best. So a linear function is recovered without error, and a smooth one to second order; between layers the values
    can exceed those of the cells. Two triangles that share a quadrilateral are averaged first.

    Raises :class:`BadValues` for another length, values that are not finite, and fewer than 3 nodes on a side.
    """
    parts = mesh.mesh_parts()
    values = cell_values(averages, mesh)
    if parts.shape is None:
        raise BadValues("averages over the cells of a mesh of blocks: return values at the nodes")
    if min(parts.shape) < MIN_NODES:
        raise BadValues(f"values at the nodes need at least {MIN_NODES} nodes on each side, not {parts.shape}")
    corners = parts.points.reshape(*parts.shape, 2)
    centres = _centroids(corners)
    rows, columns = (_patches(n) for n in parts.shape)
    i, j = rows[:, None, :, None], columns[None, :, None, :]
    around = centres[i, j].reshape(-1, 4, 2) - parts.points[:, None, :]
    size = np.abs(around).max(axis=1, keepdims=True)
    planes = np.concatenate([np.ones((len(around), 4, 1)), around / size], axis=2)
    at_nodes = np.linalg.pinv(planes)[:, 0, :]  # the weights of the four averages in the value of the plane at the node
    found: Array = (at_nodes * values[i, j].reshape(-1, 4)).sum(axis=1)
    return found.reshape(parts.shape)


def _patches(nodes: int) -> IntArray:
    """The two cells along one direction that are nearest to each node, shape ``(nodes, 2)``."""
    first = np.clip(np.arange(nodes) - 1, 0, nodes - 3)
    return np.stack([first, first + 1], axis=1)


def _centroids(nodes: Array) -> Array:
    """The centroids of the quadrilaterals, shape ``(n_xi - 1, n_eta - 1, 2)``."""
    a, b, c, d = nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]
    first, second = _area(a, b, c), _area(a, c, d)
    weighted: Array = (first * (a + b + c) + second * (a + c + d)) / (3 * (first + second))
    return weighted


def _area(a: Array, b: Array, c: Array) -> Array:
    """Twice the signed area of triangles."""
    ab, ac = b - a, c - a
    doubled: Array = ab[..., :1] * ac[..., 1:] - ab[..., 1:] * ac[..., :1]
    return doubled
