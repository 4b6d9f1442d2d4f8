"""Values at the nodes from averages over cells, and what cells and edges a node has."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh_coupling.arrays import finite, real
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import Array, HasParts, IntArray, MeshParts


@dataclass(frozen=True, eq=False)
class ErrorIndicator:
    """An error indicator of a solver: one of its ``values`` for each cell, in the order of the cells, none negative."""

    values: npt.ArrayLike


@dataclass(frozen=True, eq=False)
class CellAverages:
    """Averages of a solution over the cells: one of the ``values`` for each cell, in the order of the cells."""

    values: npt.ArrayLike


def cell_values(wrapped: ErrorIndicator | CellAverages, mesh: HasParts) -> Array:
    """The values of an error indicator or of cell averages for each quadrilateral, shape ``(n_xi - 1, n_eta - 1)``.

    On triangles an indicator has one value for each of them: that of a quadrilateral is the root of the sum of
    squares. The average over a quadrilateral is that of its triangles, by their areas.

    Raises :class:`BadValues` for another length, values that are not finite, and a negative indicator.
    """
    parts = mesh.mesh_parts()
    is_indicator = isinstance(wrapped, ErrorIndicator)
    what = "the error indicator" if is_indicator else "the array of cell averages"
    values = finite(real(wrapped.values, what), what)
    quads, triangles = cell_counts(parts)
    if is_indicator and values.size and values.min() < 0.0:
        raise BadValues("the error indicator has negative values: return the size of the error on each cell")
    is_flat = max(values.shape, default=1) == values.size
    if values.size == quads and (is_flat or values.shape == parts.cell_shape):
        return values.reshape(parts.cell_shape)
    if values.size == triangles and is_flat:
        parts = mesh.mesh_parts("triangle")
        pairs = values.reshape(-1, 2)
        merged = np.sqrt((pairs**2).sum(axis=1)) if is_indicator else _mean_of_pairs(pairs, parts)
        return np.asarray(merged.reshape(parts.cell_shape))
    raise BadValues(
        f"{what} has {values.size} values of shape {values.shape}, and this mesh has {quads} quadrilaterals, or "
        f"{triangles} triangles: return one value for each, flat or of shape {parts.cell_shape}"
    )


def _mean_of_pairs(pairs: Array, parts: MeshParts) -> Array:
    corners = parts.points[parts.cells]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).reshape(-1, 2)
    return np.asarray((pairs * areas).sum(axis=1) / areas.sum(axis=1))


def cell_counts(parts: MeshParts) -> tuple[int, int]:
    """The number of quadrilaterals, and of triangles cut from them."""
    quads = math.prod(parts.cell_shape)
    return quads, 2 * quads


def unique_edges(cells: IntArray) -> tuple[IntArray, IntArray]:
    """Every edge of ``cells`` once, shape ``(k, 2)``, and the number of each edge of each cell, shape of ``cells``.

    Edge ``j`` of a cell leads from its corner ``j`` to the next. The direction of an edge is that in its first cell.
    """
    ends = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    _, first, number = np.unique(_keys(ends), return_index=True, return_inverse=True)
    return ends[first], number.reshape(cells.shape)


def edge_numbers(wanted: IntArray, edges: IntArray) -> IntArray:
    """The places of the ``wanted`` edges, shape ``(k, 2)``, among ``edges``, in either direction."""
    keys = _keys(edges)
    order = np.argsort(keys)
    found: IntArray = order[np.searchsorted(keys, _keys(wanted), sorter=order)]
    return found


def _keys(edges: IntArray) -> IntArray:
    """One number for each edge, the same in both directions; it holds up to 2**31 nodes."""
    ends = np.sort(np.asarray(edges, dtype=np.int64), axis=1)
    keys: IntArray = ends[:, 0] << 32 | ends[:, 1]
    return keys


# The least number of cells near a node: three centroids give a plane.
MIN_CELLS = 3


def cells_near_nodes(cells: IntArray, count: int) -> Iterator[tuple[IntArray, IntArray]]:
    """The cells near each of ``count`` nodes: nodes, shape ``(k,)``, and their cells, shape ``(k, c)``, for each c.

    They are the cells around the node. A node on the boundary also has their neighbours, since the cells around it
    alone lie in one row. Raises :class:`BadValues` where a node has fewer than three.
    """
    edges, of_cells = unique_edges(cells)
    first, second = _both_cells(of_cells, len(edges))
    is_outer = np.zeros(count, dtype=bool)
    is_outer[edges[second < 0]] = True
    nodes, owners = cells.ravel(), np.repeat(np.arange(len(cells)), cells.shape[1])
    outer = np.flatnonzero(is_outer[nodes])
    others = first[of_cells[owners[outer]]] + second[of_cells[owners[outer]]] - owners[outer][:, None]
    known = second[of_cells[owners[outer]]] >= 0
    beyond = np.repeat(nodes[outer], cells.shape[1]).reshape(known.shape)[known]
    pairs = np.concatenate([nodes * len(cells) + owners, beyond * len(cells) + others[known]])
    at, near = np.divmod(np.unique(pairs), len(cells))
    sizes = np.bincount(at, minlength=count)
    starts = np.cumsum(sizes) - sizes
    if sizes.min() < MIN_CELLS:
        raise BadValues(
            f"node {int(sizes.argmin())} has {int(sizes.min())} cells near it: averages over cells give values at the "
            f"nodes where each has at least {MIN_CELLS}"
        )
    for size in np.unique(sizes).tolist():
        chosen = np.flatnonzero(sizes == size)
        yield chosen, near[starts[chosen][:, None] + np.arange(size)]


def _both_cells(of_cells: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """The two cells of each of ``count`` edges, the second one -1 on the boundary; ``of_cells`` has those of cells."""
    owners, edges = np.repeat(np.arange(len(of_cells)), of_cells.shape[1]), of_cells.ravel()
    first, second = np.full(count, len(of_cells)), np.full(count, -1)
    np.minimum.at(first, edges, owners)
    np.maximum.at(second, edges, owners)
    second[second == first] = -1
    return first, second


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
