"""Regions: the cells of a mesh shared out among subdomains, each with layers of its neighbours' cells.

Layers are counted through the nodes of cells, so that they reach through interfaces and around singular nodes alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.least_error.cells import Cells
from equimesh.numerics.types import IntArray


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
        self._original = originals(cells)
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
        place = {int(cell): spot for spot, cell in enumerate(listed)} if cells.corner_cuts else {}
        local = Cells(
            corners=corners,
            starts=np.concatenate([[0], np.cumsum(used)]),
            places=np.argsort(corners.ravel(), kind="stable"),
            triples=local_triples,
            free=cells.free[:, nodes] * free,
            # A node in no triple has no derivative either; 1 lets its block have an inverse.
            stiffness=np.maximum(squares[0] + 4.0 * squares[1] + squares[2], 1.0),
            corner_cuts={place[cell]: cut for cell, cut in cells.corner_cuts.items() if cell in place},
            ties=np.stack([copies, stands[copies]], axis=1),
        )
        number[nodes] = -1
        return local, self._node_owner[nodes] == k, int(is_own.sum())


def originals(cells: Cells) -> IntArray:
    """The node whose moves each node makes: itself, or the original of a copy, shape ``(nodes,)``."""
    found: IntArray = np.arange(cells.nodes)
    if cells.ties.size:
        copies, there = cells.ties.T
        found[copies] = there
        while not np.array_equal(found, found[found]):
            found = found[found]
    return found
