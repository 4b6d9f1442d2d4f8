"""Coarser meshes of a mesh in blocks: some of its lines. Every node of theirs is a node of the finest mesh."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from equimesh.meshes.quad_mesh import QuadMesh, quads_of_block
from equimesh.numerics.types import IntArray

COARSEST_CELLS = 4
"""Cells along each edge of a block on the coarsest mesh, or up to a half more; fewer where the block has fewer."""
COARSEST_POINTS = 300
"""Points of the coarsest mesh, at least."""
STEPS = ((1200, 60), (4000, 60), (16_000, 30), (70_000, 5), (300_000, 3))
"""Steps of descent, at most, on meshes of at most this many points."""
STEPS_BEYOND = 1
"""Steps on finer meshes, at most: the coarser ones have done the work."""
GAUSS_POINTS = ((300, 4), (1200, 3))
"""Gauss points a direction and cell on meshes of at most this many points."""
GAUSS_POINTS_BEYOND = 2
"""On finer meshes."""


@dataclass(frozen=True)
class Edge:
    """The edge of a block at the first (0) or last (1) line of an axis."""

    block: int
    axis: int
    end: int
    is_turned: bool = False
    """Whether it runs against the edge that it was found from."""


class Edges:
    """Which edges of blocks are one."""

    def __init__(self, blocks: Sequence[IntArray], originals: IntArray) -> None:
        self._at: dict[tuple[int, ...], list[Edge]] = {}
        self._key: dict[tuple[int, int, int], tuple[int, ...]] = {}
        for block, nodes in enumerate(blocks):
            for axis, end in np.ndindex(2, 2):
                along = originals[nodes[-end] if axis == 0 else nodes[:, -end]]
                ends = along[[0, 1, -2, -1]].tolist()
                key, is_turned = min((tuple(ends), False), (tuple(ends[::-1]), True))
                self._at.setdefault(key, []).append(Edge(block, int(axis), int(end), is_turned))
                self._key[block, int(axis), int(end)] = key

    def across(self, block: int, axis: int, end: int) -> Edge | None:
        """The same edge as one of the block on its other side; ``None`` on the boundary."""
        both = self._at[self._key[block, axis, end]]
        if len(both) < 2:
            return None
        here = next(k for k, edge in enumerate(both) if (edge.block, edge.axis, edge.end) == (block, axis, end))
        other = both[1 - here]
        return Edge(other.block, other.axis, other.end, other.is_turned != both[here].is_turned)


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockLevel:
    """One of the nested meshes."""

    number: int
    """0 for the coarsest mesh."""
    count: int
    """How many meshes there are."""
    lines: tuple[tuple[IntArray, IntArray], ...]
    """For each block the numbers of its lines i and j among those of the finest mesh."""
    nodes: IntArray
    """The numbers of the nodes on the finest mesh, which increase."""
    blocks: tuple[IntArray, ...]
    """For each block its nodes, as numbers of this level."""
    cells: IntArray
    """The corners of every cell, shape ``(cells, 4)``."""
    ties: IntArray
    """Nodes that move together, ``(copy, original)``."""
    edges: Edges
    """Which edges of blocks are one."""

    @property
    def is_finest(self) -> bool:
        """Whether it is the requested mesh."""
        return self.number == self.count - 1

    @property
    def points(self) -> int:
        """Number of nodes."""
        return self.nodes.size

    @property
    def steps(self) -> int:
        """The largest number of steps of descent."""
        return next((steps for most, steps in STEPS if self.points <= most), STEPS_BEYOND)

    @property
    def gauss_points(self) -> int:
        """Gauss points a direction and cell of the error."""
        return next((points for most, points in GAUSS_POINTS if self.points <= most), GAUSS_POINTS_BEYOND)


def block_levels(mesh: QuadMesh) -> list[BlockLevel]:
    """The nested meshes up to ``mesh``, with about half as many lines each way on each coarser one."""
    edges = edges_of(mesh)
    families = Families(mesh, edges)
    halvings = 0
    while True:
        counts = families.counts(halvings + 1)
        points = sum((n + 1) * (m + 1) for n, m in families.of_blocks(counts))
        if points < COARSEST_POINTS or np.array_equal(counts, families.counts(halvings)):
            break
        halvings += 1
    return [_level(mesh, edges, families, number, halvings + 1) for number in range(halvings + 1)]


def only_level(mesh: QuadMesh) -> BlockLevel:
    """The mesh itself, where no coarser ones are of use. Its blocks are not looked at."""
    return BlockLevel(
        number=0,
        count=1,
        lines=(),
        nodes=np.arange(len(mesh.points)),
        blocks=(),
        cells=mesh.cells,
        ties=mesh.ties,
        edges=Edges((), np.arange(0)),
    )


class Families:
    """Families of lines: opposite edges of a block have as many cells, and so have the edges opposite to these."""

    def __init__(self, mesh: QuadMesh, edges: Edges) -> None:
        # Follow families from block to block, through the edges that these share.
        count = len(mesh.blocks)
        family, turned = -np.ones((count, 2), dtype=int), np.zeros((count, 2), dtype=bool)
        self._finest: list[int] = []
        for block, axis in np.ndindex(count, 2):
            if family[block, axis] >= 0:
                continue
            number = len(self._finest)
            self._finest.append(mesh.blocks[block].shape[axis] - 1)
            family[block, axis], stack = number, [(block, axis)]
            while stack:
                here, along = stack.pop()
                for end in (0, 1):
                    # The edges that run along this axis are at both ends of the other one.
                    other = edges.across(here, 1 - along, end)
                    if other is not None and family[other.block, 1 - other.axis] < 0:
                        family[other.block, 1 - other.axis] = number
                        turned[other.block, 1 - other.axis] = turned[here, along] != other.is_turned
                        stack.append((other.block, 1 - other.axis))
        self._of = [(int(a), int(b)) for a, b in family]
        self._turned = [(bool(a), bool(b)) for a, b in turned]

    def counts(self, halvings: int) -> list[int]:
        """The cells along each family after so many halvings, not fewer than ``COARSEST_CELLS``."""
        found = []
        for cells in self._finest:
            most = max(0, round(math.log2(cells / COARSEST_CELLS)))
            found.append(max(1, round(cells / 2 ** min(halvings, most))))
        return found

    def of_blocks(self, counts: Sequence[int]) -> Iterator[tuple[int, int]]:
        """The cells of each block along i and along j."""
        for one, other in self._of:
            yield counts[one], counts[other]

    def lines(self, counts: Sequence[int]) -> Iterator[tuple[IntArray, IntArray]]:
        """For each block the lines i and j that are kept, equal on both blocks of an edge."""
        kept = [np.round(np.linspace(0, n, m + 1)).astype(np.int64) for n, m in zip(self._finest, counts, strict=True)]
        for of, turned in zip(self._of, self._turned, strict=True):
            one, other = (
                (self._finest[k] - kept[k][::-1] if is_turned else kept[k])
                for k, is_turned in zip(of, turned, strict=True)
            )
            yield one, other


def edges_of(mesh: QuadMesh) -> Edges:
    """The edges of the blocks of a mesh; those of a periodic join are one, too."""
    return Edges(mesh.blocks, originals_of(len(mesh.points), mesh.ties))


def originals_of(nodes: int, ties: IntArray) -> IntArray:
    """For each node its original, shape ``(nodes,)``."""
    originals = np.arange(nodes)
    originals[ties[:, 0]] = ties[:, 1]
    return originals


def _level(mesh: QuadMesh, edges: Edges, families: Families, number: int, count: int) -> BlockLevel:
    counts = families.counts(count - 1 - number)
    lines = tuple(families.lines(counts))
    on_finest = [block[np.ix_(*kept)] for block, kept in zip(mesh.blocks, lines, strict=True)]
    is_finest = number == count - 1
    place = np.full(len(mesh.points), -1)
    if is_finest:
        nodes = np.arange(len(mesh.points))
    else:
        is_kept = np.zeros(len(mesh.points), dtype=bool)
        for block in on_finest:
            is_kept[block] = True
        nodes = np.flatnonzero(is_kept)
    place[nodes] = np.arange(nodes.size)
    blocks = tuple(place[block] for block in on_finest)
    ties = place[mesh.ties]
    return BlockLevel(
        number=number,
        count=count,
        lines=lines,
        nodes=nodes,
        blocks=blocks,
        cells=mesh.cells if is_finest else np.concatenate([quads_of_block(block) for block in blocks]),
        ties=ties[(ties >= 0).all(axis=1)],
        edges=edges,
    )
