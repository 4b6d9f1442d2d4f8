"""The edges between the cells of any mesh of quadrilaterals: which cells lie on their two sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray

NO_CELL = -1
"""What stands for the second cell of an edge on the boundary."""


@dataclass(frozen=True, eq=False)
class CellEdges:
    """Every edge of some cells once, in the order of the first cell that has it.

    ``cells`` are the two cells of each edge, shape ``(k, 2)``, the lower number first; on the boundary the second is
    ``NO_CELL``. ``places`` are the corners of the two cells where the edge begins, counter-clockwise around each, shape
    ``(k, 2)``. ``of_cells`` are the numbers of the edges of each cell, shape ``(m, 4)``; edge j leads from corner j to
    the next.
    """

    cells: IntArray
    places: IntArray
    of_cells: IntArray

    @classmethod
    def of(cls, cells: IntArray, count: int, ties: IntArray | None = None) -> CellEdges:
        """The edges of ``cells``, shape ``(m, 4)``, with ``count`` nodes.

        ``ties``, shape ``(k, 2)``, are pairs of nodes that count as one: a copy and its original. Raises
        :class:`~equimesh.errors.InputError` where an edge belongs to more than two cells.
        """
        originals = originals_of(count, ties)
        corners = np.ascontiguousarray(originals[cells])
        sides, places = np.full((4 * len(cells), 2), NO_CELL), np.zeros((4 * len(cells), 2), dtype=np.int64)
        of_cells = np.empty((len(cells), 4), dtype=np.int64)
        found = find_edges(corners, count, sides, places, of_cells)
        if found < 0:
            cell, place = divmod(-found - 1, 4)
            a, b = cells[cell, place], cells[cell, (place + 1) % 4]
            raise InputError(
                f"the edge from node {a} to node {b} has more than two cells, one of them cell {cell}", field="cells"
            )
        return cls(sides[:found], places[:found], of_cells)

    @property
    def is_outer(self) -> BoolArray:
        """Whether each edge is on the boundary, shape ``(k,)``."""
        return np.asarray(self.cells[:, 1] == NO_CELL)

    @property
    def neighbours(self) -> IntArray:
        """The cell across each edge of each cell, shape ``(m, 4)``; ``NO_CELL`` on the boundary."""
        both = self.cells[self.of_cells]
        own = np.arange(len(self.of_cells))[:, None]
        return np.where(both[..., 0] == own, both[..., 1], both[..., 0])


def originals_of(count: int, ties: IntArray | None) -> IntArray:
    """The node that each of ``count`` nodes is a copy of, or itself, shape ``(count,)``."""
    originals = np.arange(count)
    if ties is None or not len(ties):
        return originals
    originals[ties[:, 0]] = ties[:, 1]
    while not np.array_equal(further := originals[originals], originals):  # a copy of a copy
        originals = further
    return originals


@compiled
def find_edges(cells: IntArray, count: int, sides: IntArray, places: IntArray, of_cells: IntArray) -> int:
    """The number of edges, whose rows are written; or -1 minus the place of a third cell, ``4 cell + corner``.

    Edges are kept in a list for each lower node.
    """
    first, after = np.full(count, -1), np.empty(4 * len(cells), dtype=np.int64)
    higher, found = np.empty(4 * len(cells), dtype=np.int64), 0
    for k in range(len(cells)):
        for j in range(4):
            a, b = cells[k, j], cells[k, (j + 1) % 4]
            low, high = min(a, b), max(a, b)
            edge = first[low]
            while edge >= 0 and higher[edge] != high:
                edge = after[edge]
            if edge < 0:
                edge = found
                higher[edge], after[edge], first[low] = high, first[low], edge
                sides[edge, 0], places[edge, 0] = k, j
                found += 1
            elif sides[edge, 1] >= 0:
                return -1 - (4 * k + j)
            else:
                sides[edge, 1], places[edge, 1] = k, j
            of_cells[k, j] = edge
    return found


# Sides of a mesh that are joined by a translation: what solvers call a pair of periodic boundaries.


@dataclass(frozen=True, kw_only=True, eq=False)
class Join:
    """Two named sides that are one: the ``original`` and its ``copy``, which lies ``translation`` away from it.

    ``edges`` are those of the copy, shape ``(k, 2)``, each in the place of its original among the edges of that side,
    and in its direction: ``edges[k, 0]`` is the copy of the node ``sides[original][k, 0]``. So they have the domain on
    their right. ``original_edges`` are those of the original.
    """

    original: str
    copy: str
    edges: IntArray
    original_edges: IntArray
    translation: Array

    @property
    def nodes(self) -> IntArray:
        """The pairs of nodes (copy, original) along the two sides, shape ``(n, 2)``, each once."""
        pairs: IntArray = np.unique(np.column_stack([self.edges.ravel(), self.original_edges.ravel()]), axis=0)
        return pairs


def joins_of(points: Array, sides: Mapping[str, IntArray], ties: IntArray) -> tuple[Join, ...]:
    """The pairs of joined sides; ``ties``, shape ``(k, 2)``, are nodes that are copies, and their originals.

    Raises :class:`~equimesh.errors.InputError` where a side is joined in part, to several sides, or to itself.
    """
    if not len(ties):
        return ()
    originals = originals_of(len(points), ties)
    keys = {name: _keys(originals[edges]) for name, edges in sides.items()}
    copies = {name: int(np.isin(edges, ties[:, 0]).sum()) for name, edges in sides.items()}
    found, joined = [], set[str]()
    for one, two in combinations(sides, 2):
        if np.isin(keys[one], keys[two]).any():
            original, copy = (two, one) if copies[one] > copies[two] else (one, two)
            if joined & {one, two} or not np.array_equal(np.sort(keys[one]), np.sort(keys[two])):
                raise _in_part(one)
            joined |= {one, two}
            places = np.argsort(keys[copy])[np.searchsorted(np.sort(keys[copy]), keys[original])]
            edges = sides[copy][places, ::-1]
            translation = points[edges[0, 0]] - points[sides[original][0, 0]]
            found.append(
                Join(
                    original=original,
                    copy=copy,
                    edges=edges,
                    original_edges=sides[original],
                    translation=translation,
                )
            )
    for name, found_keys in keys.items():
        if len(np.unique(found_keys)) < len(found_keys):
            raise _in_part(name)
    return tuple(found)


def _keys(edges: IntArray) -> IntArray:
    """One number for each edge, the same in both directions."""
    low, high = edges.min(axis=1), edges.max(axis=1)
    keys: IntArray = low << 32 | high
    return keys


def _in_part(name: str) -> InputError:
    message = f"the side {name} is joined in part, to several sides, or to itself: name each joined edge as a side"
    return InputError(message, field="sides")


# Which cells of a mesh of quadrilaterals meet: at their nodes, and along their edges.

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
