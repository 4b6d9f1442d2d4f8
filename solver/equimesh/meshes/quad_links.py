"""Which cells of a mesh of quadrilaterals meet: at their nodes, and along their edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from equimesh.meshes.cell_edges import CellEdges
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import IntArray

MAX_SPOKES = 64
"""Edges of one node, at most, that are followed around it."""


class QuadLinks(NamedTuple):
    """The cells of a mesh, and their neighbours.

    Edge k of a cell leads from its corner k to its corner k + 1, counter-clockwise; the last one leads to corner 0.
    """

    cells: IntArray
    """The nodes of every cell, counter-clockwise, shape ``(m, 4)``."""
    neighbours: IntArray
    """The cell beyond every edge, -1 at the boundary, shape ``(m, 4)``."""
    starts: IntArray
    """Where the entries of each node begin in ``places``, shape ``(n + 1,)``."""
    places: IntArray
    """The corners of cells that each node is, as ``4 cell + corner``."""

    def boundary(self) -> IntArray:
        """The edges of the boundary, as ``4 cell + edge``."""
        return np.flatnonzero(self.neighbours.reshape(-1) < 0)


def links_of(cells: IntArray, nodes: int) -> QuadLinks:
    """The links of ``cells`` of shape ``(m, 4)`` over so many ``nodes``; every edge belongs to one or two cells."""
    corners = np.ascontiguousarray(cells, dtype=np.int64)
    return QuadLinks(corners, CellEdges.of(corners, nodes).neighbours, *places_of(corners, nodes))


@compiled
def places_of(cells: IntArray, nodes: int) -> tuple[IntArray, IntArray]:
    """Where the places of each node begin, shape ``(nodes + 1,)``, and its places: ``4 cell + corner``, in order."""
    starts = np.zeros(nodes + 1, dtype=np.int64)
    for cell in range(cells.shape[0]):
        for corner in range(4):
            starts[cells[cell, corner] + 1] += 1
    for node in range(nodes):
        starts[node + 1] += starts[node]
    places, ends = np.empty(4 * cells.shape[0], dtype=np.int64), starts[:-1].copy()
    for cell in range(cells.shape[0]):
        for corner in range(4):
            node = cells[cell, corner]
            places[ends[node]] = 4 * cell + corner
            ends[node] += 1
    return starts, places


@compiled
def spokes_of(node: int, links: QuadLinks, spokes: IntArray) -> tuple[int, bool]:
    """The other ends of the edges of a node, counter-clockwise, in ``spokes``; their number, and whether they close.

    At the boundary they begin with the edge that has the domain on its left. Where cells meet in this node alone,
    those around the first one count.
    """
    cells, neighbours = links.cells, links.neighbours
    first = links.places[links.starts[node]]
    cell, corner = first // 4, first % 4
    closed = False
    for _ in range(MAX_SPOKES):  # clockwise, to the boundary or once around
        beyond = neighbours[cell, corner]
        if beyond < 0:
            break
        corner = corner_at(cells, beyond, node)
        cell = beyond
        if 4 * cell + corner == first:
            closed = True
            break
    count = 0
    first = 4 * cell + corner
    while count < MAX_SPOKES - 1:
        spokes[count] = cells[cell, (corner + 1) % 4]
        count += 1
        before = (corner + 3) % 4
        beyond = neighbours[cell, before]
        if beyond < 0:
            spokes[count] = cells[cell, before]
            count += 1
            break
        cell, corner = beyond, corner_at(cells, beyond, node)
        if 4 * cell + corner == first:
            break
    return count, closed


@compiled
def corner_at(cells: IntArray, cell: int, node: int) -> int:
    """The corner of a cell that is this node."""
    for corner in range(3):
        if cells[cell, corner] == node:
            return corner
    return 3
