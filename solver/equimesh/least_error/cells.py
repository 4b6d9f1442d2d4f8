"""The cells of a mesh as lists of nodes, and what follows from them alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.cuts import corner_cuts

MAX_CACHED_GRIDS = 16
"""Small grids whose cells are kept: the levels of one or two solves."""
MAX_CACHED_POINTS = 129 * 129
"""Points of a small grid. Of larger ones only the last is kept: its cells take 150 bytes a point."""


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

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.corners)

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return self.starts.size - 1


def cells_of_grid(shape: tuple[int, int]) -> Cells:
    """The cells of a grid with this many points, with the numbers of :class:`~equimesh.meshes.mesh.Mesh`."""
    return _of_small_grid(shape) if shape[0] * shape[1] <= MAX_CACHED_POINTS else _of_large_grid(shape)


@lru_cache(maxsize=MAX_CACHED_GRIDS)
def _of_small_grid(shape: tuple[int, int]) -> Cells:
    return _cells(shape)


@lru_cache(maxsize=1)
def _of_large_grid(shape: tuple[int, int]) -> Cells:
    return _cells(shape)


def _cells(shape: tuple[int, int]) -> Cells:
    number = np.arange(shape[0] * shape[1]).reshape(shape)
    corners = np.stack([q.ravel() for q in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:])], 1)
    along_xi = np.stack([number[:-2], number[1:-1], number[2:]], axis=-1).reshape(-1, 3)
    along_eta = np.stack([number[:, :-2], number[:, 1:-1], number[:, 2:]], axis=-1).reshape(-1, 3)
    triples = np.concatenate([along_xi, along_eta])
    free = np.ones((2, *shape))
    free[0, 0] = free[0, -1] = free[1, :, 0] = free[1, :, -1] = 0.0
    used = np.bincount(corners.ravel(), minlength=number.size)
    squares = [np.bincount(triples[:, k], minlength=number.size) for k in range(3)]
    return Cells(
        corners=corners,
        starts=np.concatenate([[0], np.cumsum(used)]),
        places=np.argsort(corners.ravel(), kind="stable"),
        triples=triples,
        free=free.reshape(2, -1),
        stiffness=squares[0] + 4.0 * squares[1] + squares[2],
        corner_cuts=corner_cuts((shape[0] - 1, shape[1] - 1)),
    )
