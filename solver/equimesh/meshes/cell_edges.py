"""What any mesh of quadrilaterals connects: the nodes of its cells, sides and blocks, and the edges between cells."""

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


# What a mesh has besides the coordinates of its nodes, checked.


def no_ties() -> IntArray:
    """No pairs of nodes that are one."""
    return np.empty((0, 2), dtype=np.int64)


class Connected(NamedTuple):
    """Which nodes a mesh connects: all that it has besides their coordinates."""

    cells: IntArray
    sides: Mapping[str, IntArray]
    blocks: tuple[IntArray, ...]
    block_names: tuple[str, ...]
    ties: IntArray

    @classmethod
    def of(
        cls,
        points: Array,
        cells: IntArray,
        sides: Mapping[str, IntArray],
        blocks: tuple[IntArray, ...],
        block_names: tuple[str, ...],
        ties: IntArray,
    ) -> Connected:
        """The same, checked; raises :class:`~equimesh.errors.InputError` for other shapes and what is no node."""
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"points has shape {points.shape}: it must be (n, 2)", field="points")
        edges = {f"sides.{name}": (found, 2) for name, found in sides.items()}
        for name, (table, columns) in {"cells": (cells, 4), "ties": (ties, 2), **edges}.items():
            check_table(table, name, columns, len(points))
        _check_blocks(blocks, len(points))
        return cls(cells, sides, blocks, _names_of(blocks, block_names), ties)


def check_table(table: IntArray, name: str, columns: int, count: int) -> None:
    """Refuse another number of columns, and what is no number of a node."""
    if table.size and table.dtype.kind not in "iu":
        raise InputError(f"{name} has values of the type {table.dtype}: give the numbers of nodes", field=name)
    if table.ndim != 2 or table.shape[1] != columns:
        raise InputError(f"{name} has shape {table.shape}: it must be (k, {columns})", field=name)
    _check_numbers(table, name, count)


def _check_blocks(blocks: tuple[IntArray, ...], count: int) -> None:
    """Refuse blocks of other shapes, and numbers that are no nodes."""
    for k, block in enumerate(blocks):
        if block.ndim != 2 or min(block.shape) < 2:
            raise InputError(f"blocks[{k}] has shape {block.shape}: at least 2 nodes each way", field=f"blocks[{k}]")
    numbers = np.concatenate([block.reshape(-1) for block in blocks]) if blocks else np.empty(0)
    if numbers.size and not (numbers.min() >= 0 and numbers.max() < count):
        for k, block in enumerate(blocks):
            _check_numbers(block, f"blocks[{k}]", count)


def _names_of(blocks: tuple[IntArray, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    """A name for each block."""
    if names and len(names) != len(blocks):
        message = f"{len(names)} names for {len(blocks)} blocks: one name for each block"
        raise InputError(message, field="block_names")
    return names or tuple(f"block{k}" for k in range(len(blocks)))


def cells_of_blocks(blocks: tuple[IntArray, ...], cells: IntArray) -> tuple[IntArray, ...]:
    """For each block the places of its cells among ``cells``, shape ``(n_i - 1, n_j - 1)``."""
    if not blocks:
        return ()
    corners = [quads_of_block(block) for block in blocks]
    ends = np.cumsum([len(block) for block in corners])
    wanted = np.concatenate(corners)
    if len(wanted) == len(cells) and np.array_equal(wanted, cells):
        found = np.arange(len(cells))
    else:
        found = _places(np.sort(cells, axis=1), np.sort(wanted, axis=1))
    pieces = np.split(found, ends[:-1])
    shapes = [(block.shape[0] - 1, block.shape[1] - 1) for block in blocks]
    return tuple(piece.reshape(shape) for piece, shape in zip(pieces, shapes, strict=True))


def quads_of_block(block: IntArray) -> IntArray:
    """The nodes of every cell of a block, counter-clockwise, shape ``(m, 4)``; j runs fastest."""
    corners = block[:-1, :-1], block[1:, :-1], block[1:, 1:], block[:-1, 1:]
    return np.stack([corner.ravel() for corner in corners], axis=1)


def _check_numbers(table: IntArray, name: str, count: int) -> None:
    """Refuse numbers that are no nodes."""
    if table.size and not (table.min() >= 0 and table.max() < count):
        place = np.unravel_index(int(((table < 0) | (table >= count)).argmax()), table.shape)
        where = "".join(f"[{int(k)}]" for k in place)
        raise InputError(f"{name}{where} = {table[place]}: the nodes have the numbers 0 to {count - 1}", field=name)


def _places(rows: IntArray, wanted: IntArray) -> IntArray:
    """The place among ``rows`` of each of the ``wanted`` rows; both have four sorted columns."""
    both = np.concatenate([rows, wanted])
    order = np.lexsort(both.T[::-1])
    ordered = both[order]
    starts = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    group = np.empty(len(both), dtype=np.int64)
    group[order] = np.cumsum(starts) - 1
    place = np.full(group.max() + 1, -1)
    place[group[: len(rows)]] = np.arange(len(rows))
    found = place[group[len(rows) :]]
    if found.size and found.min() < 0:
        cell = wanted[found.argmin()].tolist()
        raise InputError(f"a block has a cell with the nodes {cell}, which is no cell of the mesh", field="blocks")
    return found
