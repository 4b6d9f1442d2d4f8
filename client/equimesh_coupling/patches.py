"""The cells near each node of a mesh without rows and columns."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from equimesh_coupling.edges import unique_edges
from equimesh_coupling.errors import BadValues
from equimesh_coupling.parts import IntArray

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
