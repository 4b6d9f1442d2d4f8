"""The cells of a mesh as lists of nodes, and what follows from them alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

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
