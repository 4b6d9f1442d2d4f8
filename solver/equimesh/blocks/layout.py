"""The topology of blocks: which edges and vertices they share, and how their nodes are numbered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar, overload

import numpy as np
import scipy
from numpy.typing import NDArray

from equimesh.errors import InputError
from equimesh.numerics.types import Array, BoolArray, IntArray

Value = TypeVar("Value", bound=np.generic)

# The sides of a block, in the order of the columns of all tables: i = 0, i at its end, j = 0, j at its end.
LEFT, RIGHT, BOTTOM, TOP = range(4)
# Where the nodes of each side are in an array of those of the block.
LINES = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
# Where a side has the block on its left when it is followed with its index rising.
RISES_WITH_BLOCK_ON_LEFT = (False, True, True, False)


# The share of a scale of counts to which it is found.
HALVED_SHARE = 1e-9


def _no_joins() -> IntArray:
    return np.empty((0, 3), dtype=np.int64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """Blocks, their edges and vertices, and the number of cells along each edge.

    - ``edges``: the vertices at which every edge begins and ends, shape ``(e, 2)``. Both are one vertex where the edge
      is a closed line.
    - ``block_edges``: the edge on each side of a block, shape ``(b, 4)``; the sides are ``LEFT`` (i = 0), ``RIGHT``,
      ``BOTTOM`` (j = 0) and ``TOP``. An edge that two blocks have in common is an interface. It may be two sides of one
      block, where this closes around a hole.
    - ``forward``: whether the edge begins where the index along that side is 0, shape ``(b, 4)``.
    - ``edge_counts``: cells along every edge, shape ``(e,)``; equal on opposite sides of a block, and on joined edges.
    - ``joins``: edges that are one line up to a translation, shape ``(k, 3)``: the edge, its copy, and 1 where both
      begin at the same end, else 0.
    - ``vertex_names``: names for messages, one for each vertex.

    Raises :class:`~equimesh.errors.InputError` where counts of opposite edges differ; it names the block.
    """

    edges: IntArray
    block_edges: IntArray
    forward: BoolArray
    edge_counts: IntArray
    joins: IntArray = field(default_factory=_no_joins)
    vertex_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        pairs = self._pairs_of_equal_count()
        counts = self.edge_counts[pairs]
        if (counts[:, 0] != counts[:, 1]).any():
            one, other = pairs[int((counts[:, 0] != counts[:, 1]).argmax())]
            raise InputError(
                f"the edges {self.edge_name(one)} and {self.edge_name(other)} are opposite, and have"
                f" {self.edge_counts[one]} and {self.edge_counts[other]} cells: give both the same number",
                field="domain.blocks",
            )

    @property
    def vertex_count(self) -> int:
        """The number of vertices."""
        return int(self.edges.max()) + 1

    @property
    def block_count(self) -> int:
        """The number of blocks."""
        return len(self.block_edges)

    @cached_property
    def classes(self) -> IntArray:
        """The class of every edge, shape ``(e,)``: edges that are opposite in a block, or joined, have one class."""
        pairs = self._pairs_of_equal_count()
        size = len(self.edges)
        graph = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
        return np.asarray(scipy.sparse.csgraph.connected_components(graph, directed=False)[1], dtype=np.int64)

    @cached_property
    def counts(self) -> IntArray:
        """Cells along the edges of every class, shape ``(c,)``."""
        found = np.empty(int(self.classes.max()) + 1, dtype=np.int64)
        found[self.classes] = self.edge_counts
        return found

    @property
    def shapes(self) -> tuple[tuple[int, int], ...]:
        """The number of nodes ``(n_i, n_j)`` of every block."""
        along_i, along_j = self.edge_counts[self.block_edges[:, BOTTOM]], self.edge_counts[self.block_edges[:, LEFT]]
        return tuple((int(i) + 1, int(j) + 1) for i, j in zip(along_i, along_j, strict=True))

    @property
    def node_count(self) -> int:
        """The number of nodes of a mesh with these counts."""
        inside = sum((i - 2) * (j - 2) for i, j in self.shapes)
        return self.vertex_count + int((self.edge_counts - 1).sum()) + inside

    @property
    def cell_count(self) -> int:
        """The number of cells of a mesh with these counts."""
        return sum((i - 1) * (j - 1) for i, j in self.shapes)

    def with_counts(self, counts: IntArray) -> Layout:
        """The same topology with other numbers of cells, one for each class, shape ``(c,)``."""
        return replace(self, edge_counts=np.asarray(counts, dtype=np.int64)[self.classes])

    def within(self, points: int, proportions: Array, least: IntArray) -> IntArray:
        """The counts of the classes in these ``proportions``, each at least its ``least`` one, of at most ``points``.

        All have the shape ``(c,)``. The counts are the largest ones, to rounding. The ``least`` ones themselves may
        have more nodes.
        """

        def fits(counts: IntArray) -> bool:
            return self.with_counts(counts).node_count <= points

        def scaled(scale: float) -> IntArray:
            return np.maximum(np.round(scale * proportions), least).astype(np.int64)

        low, high = 0.0, points / float(proportions.max())
        while high - low > HALVED_SHARE * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if fits(scaled(middle)) else (low, middle)
        found = scaled(low)
        for one in np.argsort(found / proportions, kind="stable"):
            more = found.copy()
            more[one] += 1
            found = more if fits(more) else found
        return found

    def coarser(self, factor: float) -> Layout:
        """The same topology with all counts divided by ``factor`` and rounded; at least 1 cell stays."""
        return self.with_counts(np.maximum(1, np.floor(self.counts / factor + 0.5)).astype(np.int64))

    def numbering(self) -> tuple[int, tuple[IntArray, ...]]:
        """The number of nodes, and the numbers of the nodes of every block, shape ``(n_i, n_j)`` each.

        Nodes are numbered block by block, in each block along j first; a node of several blocks has its number from the
        first one. So the nodes of one block alone have the numbers that they have in a structured mesh.
        """
        inner = self.edge_counts - 1
        starts = self.vertex_count + np.concatenate([[0], np.cumsum(inner)])
        lines = [
            np.concatenate([[a], np.arange(start, start + n), [b]])
            for (a, b), start, n in zip(self.edges, starts, inner, strict=False)
        ]
        blocks, start = [], int(starts[-1])
        for shape, edges, forward in zip(self.shapes, self.block_edges, self.forward, strict=True):
            block = np.empty(shape, dtype=np.int64)
            inside = (shape[0] - 2) * (shape[1] - 2)
            block[1:-1, 1:-1] = np.arange(start, start + inside).reshape(shape[0] - 2, shape[1] - 2)
            start += inside
            for side in range(4):
                line_of(block, side)[:] = lines[edges[side]][:: 1 if forward[side] else -1]
            blocks.append(block)
        return start, _by_first_block(blocks, start)

    def edge_nodes(self, blocks: tuple[IntArray, ...]) -> EdgeNodes:
        """The nodes of every edge from its begin to its end, for blocks with any numbering."""
        last = np.empty(len(self.edges), dtype=np.int64)
        last[self.block_edges.ravel()] = np.arange(self.block_edges.size)
        return EdgeNodes(blocks, last, self.forward.ravel()[last])

    @cached_property
    def edge_uses(self) -> IntArray:
        """How many sides of blocks lie on every edge, shape ``(e,)``: 1 on the boundary and on joined edges, else 2."""
        return np.bincount(self.block_edges.ravel(), minlength=len(self.edges))

    @property
    def boundary(self) -> IntArray:
        """The edges on the boundary: those of one block that are not joined."""
        joined = np.isin(np.arange(len(self.edges)), self.joins[:, :2])
        return np.flatnonzero((self.edge_uses == 1) & ~joined)

    @cached_property
    def neighbours(self) -> IntArray:
        """The neighbour across each side of a block, shape ``(b, 4, 3)``: block, side, and 1 where its index falls.

        The third number is 1 where the index along the common side rises in one block and falls in the other. All
        three are -1 on the boundary. Joined edges have neighbours, too: those lie apart by the translation of the join.
        """
        found = np.full((self.block_count, 4, 3), -1)
        at: dict[int, list[tuple[int, int, bool]]] = {}
        for b, side in np.ndindex(self.block_count, 4):
            at.setdefault(int(self.block_edges[b, side]), []).append((b, side, bool(self.forward[b, side])))
        pairs = [(places[0], places[1], True) for places in at.values() if len(places) == 2]
        pairs += [(at[one][0], at[copy][0], bool(same)) for one, copy, same in self.joins.tolist()]
        for one, other, same in pairs:
            falls = int((one[2] == other[2]) != same)
            found[one[0], one[1]] = other[0], other[1], falls
            found[other[0], other[1]] = one[0], one[1], falls
        return found

    def ties(self, blocks: tuple[IntArray, ...]) -> IntArray:
        """The nodes of joined edges that are one unknown, shape ``(k, 2)``: a copy, and its original.

        An original is the copy of no other node; a node at which several joins meet has one original.
        """
        lines = self.edge_nodes(blocks)
        pairs = [(lines[copy][:: 1 if same else -1], lines[one]) for one, copy, same in self.joins.tolist()]
        if not pairs:
            return np.empty((0, 2), dtype=np.int64)
        copies, originals = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
        nodes, places = np.unique(np.concatenate([copies, originals]), return_inverse=True)
        ends = places.reshape(2, -1)
        graph = scipy.sparse.coo_array((np.ones(len(copies)), (ends[0], ends[1])), shape=(len(nodes), len(nodes)))
        number, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
        is_copy = np.isin(nodes, copies)
        original = np.empty(number, dtype=np.int64)
        for pick in (is_copy, ~is_copy):  # a node that is no copy wins
            original[group[pick][::-1]] = nodes[pick][::-1]
        tied = nodes != original[group]
        return np.column_stack([nodes[tied], original[group][tied]])

    def edge_name(self, edge: int) -> str:
        """The names of both vertices of an edge, such as ``c0-c1``."""
        first, last = (self.vertex_name(int(vertex)) for vertex in self.edges[edge])
        return f"{first}-{last}"

    def vertex_name(self, vertex: int) -> str:
        """The name of a vertex, its number where it has none."""
        return self.vertex_names[vertex] if self.vertex_names else str(vertex)

    def counts_of(self, shapes: Sequence[tuple[int, ...]]) -> IntArray | None:
        """The counts of the classes for blocks with these numbers of nodes; ``None`` where they do not fit together."""
        if len(shapes) != self.block_count:
            return None
        along_i, along_j = np.array(shapes, dtype=np.int64).T - 1
        sides = np.stack([along_j, along_j, along_i, along_i], axis=1)
        found = np.empty_like(self.counts)
        found[self.classes[self.block_edges]] = sides
        return found if np.array_equal(found[self.classes[self.block_edges]], sides) else None

    def _pairs_of_equal_count(self) -> IntArray:
        """Pairs of edges that are opposite in a block, or joined."""
        opposite = np.concatenate([self.block_edges[:, [LEFT, RIGHT]], self.block_edges[:, [BOTTOM, TOP]]])
        return np.concatenate([opposite, self.joins[:, :2]])


class EdgeNodes(Sequence[IntArray]):
    """The nodes of edges, each shape ``(n,)``, which are taken from the blocks when they are asked for.

    ``places`` are four times the number of a block with the edge, plus the side; ``forward`` is that of the layout.
    """

    def __init__(self, blocks: tuple[IntArray, ...], places: IntArray, forward: BoolArray) -> None:
        self._blocks, self._places, self._forward = blocks, places, forward

    def __len__(self) -> int:
        return len(self._places)

    @overload
    def __getitem__(self, edge: int) -> IntArray: ...
    @overload
    def __getitem__(self, edge: slice) -> list[IntArray]: ...
    def __getitem__(self, edge: int | slice) -> IntArray | list[IntArray]:
        if isinstance(edge, slice):
            return [self[k] for k in range(*edge.indices(len(self)))]
        block, side = divmod(int(self._places[edge]), 4)
        return self._blocks[block][LINES[side]][:: 1 if self._forward[edge] else -1]


def line_of(values: NDArray[Value], side: int) -> NDArray[Value]:
    """The values on a side of a block with its index rising, a view; ``values`` has the shape ``(n_i, n_j, ...)``."""
    if side in (LEFT, RIGHT):
        return np.asarray(values[0 if side == LEFT else -1])
    return np.asarray(values[:, 0 if side == BOTTOM else -1])


def _by_first_block(blocks: list[IntArray], count: int) -> tuple[IntArray, ...]:
    """The same blocks with the nodes numbered in the order in which they first occur."""
    flat = np.concatenate([block.ravel() for block in blocks])
    place = np.arange(len(flat))
    first = np.empty(count, dtype=np.int64)
    first[flat[::-1]] = place[::-1]  # the last write is the first place
    number = np.empty(count, dtype=np.int64)
    ordered = flat[first[flat] == place]
    number[ordered] = np.arange(len(ordered))
    return tuple(number[block] for block in blocks)
