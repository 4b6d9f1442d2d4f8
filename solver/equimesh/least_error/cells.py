"""The cells of a mesh: of a grid, of blocks, and those of a region of either."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from equimesh.meshes.cell_edges import originals_of, places_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.parts import corner_cuts

MAX_CACHED_GRIDS = 16
"""Small grids whose cells are kept: the levels of one or two solves."""
MAX_CACHED_POINTS = 129 * 129
"""Points of a small grid. Of larger ones only the last is kept: its cells take 150 bytes a point."""
OPEN = (False, False)
"""No lines of a grid are closed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Quadrilaterals over numbered nodes. Nothing here depends on the nodes being those of a grid."""

    corners: IntArray
    """The nodes of every cell, counter-clockwise, shape ``(cells, 4)``."""
    starts: IntArray
    """Where the entries of each node begin in ``places``, shape ``(nodes + 1,)``."""
    places: IntArray
    """The corners of cells that each node is, as ``4 cell + corner``."""
    triples: IntArray
    """Three consecutive nodes of grid lines, shape ``(triples, 3)``."""
    free: Array
    """1 where a node may move along s and along t, else 0, shape ``(2, nodes)``: nodes of a side stay on it."""
    stiffness: Array
    """The sum of squared weights of each node in the second differences of ``triples``."""
    corner_cuts: Mapping[int, int]
    """The cells that are cut into triangles through a corner of the grid, with that cut."""
    ties: IntArray
    """Nodes that move together, ``(copy, original)``, shape ``(ties, 2)``; ``triples`` name originals only."""
    closed: tuple[bool, bool] = OPEN
    """Whether lines along xi, and those along eta, end where they begin; of cells of a grid."""
    of_mesh: IntArray | None = None
    """The :attr:`sides` of a region, which are those of the mesh: its other edges lie inside. ``None`` for a mesh."""
    _apart: dict[int, list[list[tuple[int, int]]]] = field(default_factory=dict, init=False, repr=False)

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.corners)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.starts.size - 1

    @cached_property
    def sides(self) -> IntArray:
        """The edges of one cell alone whose two nodes stay on a side, shape ``(edges, 2)``."""
        if self.of_mesh is not None:
            return self.of_mesh
        held = self.free == 0.0
        candidates = held.any(axis=0)
        edges = np.concatenate(
            [
                pair[candidates[pair[:, 0]] & candidates[pair[:, 1]]]
                for pair in (self.corners[:, [k, (k + 1) % 4]] for k in range(4))
            ]
        )
        edges = edges[(held[:, edges[:, 0]] & held[:, edges[:, 1]]).any(axis=0)]
        numbers = edges.min(axis=1) * self.nodes + edges.max(axis=1)
        _, places, counts = np.unique(numbers, return_index=True, return_counts=True)
        found: IntArray = edges[places[counts == 1]]
        return found

    def apart(self, size: int) -> list[list[tuple[int, int]]]:
        """Spans of ``size`` cells, in groups: spans of one group have no node in common."""
        if size not in self._apart:
            spans = [(first, min(first + size, self.count)) for first in range(0, self.count, size)]
            groups: list[list[tuple[int, int]]] = []
            if len(spans) > 1:
                numbers = _groups_of_spans(self.corners, size, self.nodes)
                groups = [[spans[k] for k in np.flatnonzero(numbers == g)] for g in range(int(numbers.max()) + 1)]
            self._apart[size] = groups or [spans]
        return self._apart[size]

    def restrict(self, gradient: Array, blocks: Array) -> None:
        """Restrict derivatives by all coordinates to those that are free, in place.

        Originals of tied nodes get the sums over their copies. Copies keep no derivative, and unit blocks.
        """
        gradient *= self.free
        blocks[1] *= self.free[0] * self.free[1]
        if self.ties.size:
            copies, originals = self.ties.T
            for rows in (gradient, blocks):
                for row in rows:
                    np.add.at(row, originals, row[copies])
            gradient[:, copies] = 0.0
            blocks[:, copies] = np.array([1.0, 0.0, 1.0])[:, None]

    def tie(self, direction: Array) -> None:
        """Let the copies of tied nodes move as their originals, in place."""
        if self.ties.size:
            copies, originals = self.ties.T
            direction[:, copies] = direction[:, originals]


MAX_SHARED = 62
"""Groups of several spans: each is a bit of a number of 64 bits."""


@compiled
def _groups_of_spans(corners: IntArray, size: int, nodes: int) -> IntArray:
    """For each span of ``size`` cells the first group none of whose spans has a node of it, shape ``(spans,)``.

    Where cells are in no order, every span meets all others: beyond ``MAX_SHARED`` groups each has one of its own.
    """
    count, own = corners.shape[0], MAX_SHARED
    out, taken = np.zeros((count + size - 1) // size, dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    for span in range(out.size):
        first, last, seen = span * size, min((span + 1) * size, count), 0
        for cell in range(first, last):
            for k in range(4):
                seen |= taken[corners[cell, k]]
        group = 0
        while group < MAX_SHARED and seen & (1 << group):
            group += 1
        if group == MAX_SHARED:
            out[span] = own
            own += 1
            continue
        out[span] = group
        for cell in range(first, last):
            for k in range(4):
                taken[corners[cell, k]] |= 1 << group
    return out


def cells_of_grid(shape: tuple[int, int], closed: tuple[bool, bool] = OPEN) -> Cells:
    """The cells of a grid with this many points, with the numbers of :class:`~equimesh.meshes.mesh.Mesh`.

    ``closed`` tells whether lines along xi, and those along eta, end where they begin. Their two ends are tied then:
    the last node is a copy of the first.
    """
    small = shape[0] * shape[1] <= MAX_CACHED_POINTS
    return _of_small_grid(shape, closed) if small else _of_large_grid(shape, closed)


@lru_cache(maxsize=MAX_CACHED_GRIDS)
def _of_small_grid(shape: tuple[int, int], closed: tuple[bool, bool]) -> Cells:
    return _cells(shape, closed)


@lru_cache(maxsize=1)
def _of_large_grid(shape: tuple[int, int], closed: tuple[bool, bool]) -> Cells:
    return _cells(shape, closed)


def _cells(shape: tuple[int, int], closed: tuple[bool, bool]) -> Cells:
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    corners = np.stack([q.ravel() for q in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])], 1)
    originals = number.copy()
    if closed[0]:
        originals[-1] = originals[0]
    if closed[1]:
        originals[:, -1] = originals[:, 0]
    triples = _triples(originals, closed)
    free = np.ones((2, *shape))
    if not closed[0]:
        free[0, 0] = free[0, -1] = 0.0
    if not closed[1]:
        free[1, :, 0] = free[1, :, -1] = 0.0
    used = np.bincount(corners.ravel(), minlength=number.size)
    squares = [np.bincount(triples[:, k], minlength=number.size) for k in range(3)]
    copies = np.flatnonzero(originals.ravel() != number.ravel())
    return Cells(
        corners=corners,
        starts=np.concatenate([[0], np.cumsum(used)]),
        places=np.argsort(corners.ravel(), kind="stable"),
        triples=triples,
        free=free.reshape(2, -1),
        stiffness=squares[0] + 4.0 * squares[1] + squares[2],
        corner_cuts=corner_cuts((shape[0] - 1, shape[1] - 1)),
        ties=np.stack([copies, originals.ravel()[copies]], axis=1),
        closed=closed,
    )


def _triples(number: IntArray, closed: tuple[bool, bool]) -> IntArray:
    """Three consecutive nodes of grid lines; of closed ones each node once, also in the middle of the two ends."""
    along_xi, along_eta = (number[:, :-1] if closed[1] else number), (number[:-1] if closed[0] else number)
    if closed[0]:
        along_xi = np.concatenate([along_xi, along_xi[1:2]])
    if closed[1]:
        along_eta = np.concatenate([along_eta, along_eta[:, 1:2]], axis=1)
    families = [
        np.stack([along_xi[:-2], along_xi[1:-1], along_xi[2:]], axis=-1),
        np.stack([along_eta[:, :-2], along_eta[:, 1:-1], along_eta[:, 2:]], axis=-1),
    ]
    return np.concatenate([family.reshape(-1, 3) for family in families])


# The cells of any mesh of quadrilaterals, and the lines of nodes that run through them.


def cells_of_mesh(corners: IntArray, free: Array, ties: IntArray) -> Cells:
    """The cells with these ``corners``, shape ``(cells, 4)``, counter-clockwise.

    ``free`` is 1 where a coordinate of a node may change, else 0, shape ``(2, nodes)``. ``ties`` are pairs of nodes
    that move together, ``(copy, original)``.

    A line of nodes runs straight on through a node of four cells, and along the boundary through a node of two. It ends
    at other nodes: corners of the domain, and singular nodes.
    """
    nodes = free.shape[1]
    corners = np.ascontiguousarray(corners)
    starts, places = places_of(corners, nodes)
    if ties.size:
        own = originals_of(nodes, ties)[corners]
        triples = _triples_of_blocks(own, *places_of(own, nodes))
    else:
        triples = _triples_of_blocks(corners, starts, places)
    return Cells(
        corners=corners,
        starts=starts,
        places=places,
        triples=triples,
        free=free,
        stiffness=_stiffness(triples, nodes),
        corner_cuts={},
        ties=ties,
    )


@compiled
def _triples_of_blocks(corners: IntArray, starts: IntArray, places: IntArray) -> IntArray:
    """Three consecutive nodes of lines, those around one node together, shape ``(triples, 3)``."""
    out, count = np.empty((2 * (starts.size - 1), 3), dtype=np.int64), 0
    for node in range(starts.size - 1):
        first, size = starts[node], starts[node + 1] - starts[node]
        if size not in (2, 4):
            continue
        cell, corner = divmod(places[first], 4)
        ahead, behind = corners[cell, (corner + 1) % 4], corners[cell, (corner + 3) % 4]
        if size == 2:
            other, corner = divmod(places[first + 1], 4)
            ahead_there, behind_there = corners[other, (corner + 1) % 4], corners[other, (corner + 3) % 4]
            if behind == ahead_there:
                out[count, 0], out[count, 1], out[count, 2] = ahead, node, behind_there
                count += 1
            elif ahead == behind_there:
                out[count, 0], out[count, 1], out[count, 2] = behind, node, ahead_there
                count += 1
            continue
        for k in range(first + 1, first + 4):
            other, corner = divmod(places[k], 4)
            ahead_there, behind_there = corners[other, (corner + 1) % 4], corners[other, (corner + 3) % 4]
            if ahead_there not in (ahead, behind) and behind_there not in (ahead, behind):
                out[count, 0], out[count, 1], out[count, 2] = ahead, node, ahead_there
                out[count + 1, 0], out[count + 1, 1], out[count + 1, 2] = behind, node, behind_there
                count += 2
                break
    return out[:count].copy()


@compiled
def _stiffness(triples: IntArray, nodes: int) -> Array:
    """The sum of squared weights of each node in the second differences."""
    out = np.zeros(nodes)
    for k in range(triples.shape[0]):
        out[triples[k, 0]] += 1.0
        out[triples[k, 1]] += 4.0
        out[triples[k, 2]] += 1.0
    return out


# Regions: the cells of a mesh shared out among subdomains, each with layers of its neighbours' cells.
#
# Layers are counted through the nodes of cells, so that they reach through interfaces and around singular nodes
# alike.


@dataclass(frozen=True, kw_only=True, eq=False)
class Region:
    """One subdomain: its own cells, the layers around them, and one further layer whose nodes are all held fixed.

    Nodes and cells have numbers of the region in ``cells`` and ``owned``, numbers of the mesh in ``nodes``.
    """

    number: int
    nodes: IntArray
    """The nodes of the region, in ascending order."""
    cells: Cells
    """The cells of the region, its own ones first. Nodes are free whose cells are all within the overlap."""
    own_cells: int
    """How many cells are its own."""
    own_triples: int
    """How many of the first triples are its own: those with a middle node that it owns."""
    owned: IntArray
    """The nodes that the merged mesh takes from the region. Each node of the mesh has one owner."""


def regions_of(cells: Cells, owner: IntArray, overlap: int) -> tuple[Region, ...]:
    """One region for each number in ``owner``, the owner of every cell, shape ``(cells,)``.

    A region has ``overlap`` layers of cells around its own. A node belongs to the lowest of the owners of its cells.
    """
    return tuple(_Cutter(cells, owner).region(k, overlap) for k in range(int(owner.max()) + 1))


class _Cutter:
    """Cuts regions out of a mesh."""

    def __init__(self, cells: Cells, owner: IntArray) -> None:
        self._cells, self._owner = cells, owner
        self._original = originals_of(cells.nodes, cells.ties)
        corners = self._original[cells.corners]
        used = np.bincount(corners.ravel(), minlength=cells.nodes)
        self._corners, self._starts = corners, np.concatenate([[0], np.cumsum(used)])
        self._cells_of = np.argsort(corners.ravel(), kind="stable") // 4
        owners = np.full(cells.nodes, int(owner.max()) + 1)
        for k in range(4):
            np.minimum.at(owners, corners[:, k], owner)
        self._node_owner = owners[self._original]
        self._free, self._number = np.zeros(cells.nodes, dtype=bool), np.full(cells.nodes, -1)

    def region(self, k: int, overlap: int) -> Region:
        """The region of the cells with owner ``k``."""
        own = np.flatnonzero(self._owner == k)
        near = own
        for _ in range(overlap):
            near = self._with_next_layer(near)
        every = self._with_next_layer(near)
        beyond = every[~np.isin(every, near, assume_unique=True)]
        # A free node has all of its cells near: it is a corner of a near cell, and of no cell beyond.
        self._free[self._corners[near]] = True
        self._free[self._corners[beyond]] = False
        nodes, listed = np.unique(self._cells.corners[every]), np.concatenate([own, every[~np.isin(every, own)]])
        local, owned, own_triples = self._local(nodes, listed, k)
        self._free[self._corners[every]] = False
        return Region(
            number=k, nodes=nodes, cells=local, own_cells=own.size, own_triples=own_triples, owned=np.flatnonzero(owned)
        )

    def _with_next_layer(self, numbers: IntArray) -> IntArray:
        """The cells with these numbers, and all that have a node with them in common."""
        nodes = np.unique(self._corners[numbers])
        first, count = self._starts[nodes], self._starts[nodes + 1] - self._starts[nodes]
        places = np.repeat(first - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
        return np.unique(self._cells_of[places])

    def _local(self, nodes: IntArray, listed: IntArray, k: int) -> tuple[Cells, IntArray, int]:
        """The cells of a region, which of its nodes it owns, and how many triples are its own."""
        cells, number, original = self._cells, self._number, self._original
        number[nodes] = np.arange(nodes.size)
        corners = number[cells.corners[listed]]
        # Of tied nodes the first one in the region stands for all: the others are its copies.
        standing = np.full(cells.nodes, -1)
        standing[original[nodes][::-1]] = number[nodes][::-1]
        free = self._free[original[nodes]]
        stands = standing[original[nodes]]
        copies = np.flatnonzero(free & (stands != np.arange(nodes.size)))
        triples = cells.triples
        is_own = self._node_owner[triples[:, 1]] == k
        is_near = self._free[triples].any(axis=1)
        chosen = np.concatenate([np.flatnonzero(is_own), np.flatnonzero(is_near & ~is_own)])
        local_triples = standing[original[triples[chosen]]]
        squares = [np.bincount(local_triples[:, j], minlength=nodes.size) for j in range(3)]
        used = np.bincount(corners.ravel(), minlength=nodes.size)
        sides = number[cells.sides]
        place = {int(cell): spot for spot, cell in enumerate(listed)} if cells.corner_cuts else {}
        local = Cells(
            corners=corners,
            starts=np.concatenate([[0], np.cumsum(used)]),
            places=np.argsort(corners.ravel(), kind="stable"),
            triples=local_triples,
            free=np.ascontiguousarray(cells.free[:, nodes] * free),
            # A node in no triple has no derivative either; 1 lets its block have an inverse.
            stiffness=np.maximum(squares[0] + 4.0 * squares[1] + squares[2], 1.0),
            corner_cuts={place[cell]: cut for cell, cut in cells.corner_cuts.items() if cell in place},
            ties=np.stack([copies, stands[copies]], axis=1),
            of_mesh=sides[(sides >= 0).all(axis=1)],
        )
        number[nodes] = -1
        return local, self._node_owner[nodes] == k, int(is_own.sum())
