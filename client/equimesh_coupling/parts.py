"""The parts of a mesh that other libraries need: points, cells, the edges of the sides, and triangles of cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final, Literal, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh_coupling.errors import BadValues

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

# The corners of the two triangles of a cell: cut from its corner 0 to 2, or from 1 to 3.
CUTS = np.array([[[0, 1, 2], [0, 2, 3]], [[0, 1, 3], [1, 2, 3]]])
# Below this difference of angles both diagonals are equally good.
TIE_RADIANS = 1e-9
# Where no cell has to be cut through one corner.
ANYWHERE: Mapping[int, int] = MappingProxyType({})


def better_cuts(corners: Array, through: Mapping[int, int] = ANYWHERE) -> IntArray:
    """The cut of every cell, 0 or 1 as in ``CUTS``: along the diagonal that leaves the larger smallest angle.

    ``corners`` has the shape ``(cells, 4, 2)``. An inverted triangle has a negative angle, so a cut with two positive
    triangles is taken wherever there is one. The cells in ``through`` get the cut given there, unless it inverts a
    triangle.
    """
    first, second = (_smallest_angle(corners[:, cut]).min(axis=1) for cut in CUTS)
    chosen: IntArray = (second > first + TIE_RADIANS).astype(np.int64)
    for cell, cut in through.items():
        if (first, second)[cut][cell] > 0.0:
            chosen[cell] = cut
    return chosen


def corner_cuts(shape: tuple[int, int]) -> dict[int, int]:
    """The cells at the four corners of a grid of ``shape`` cells, by their numbers, with the cut through that corner.

    The other cut leaves a triangle with two edges on the boundary: all its nodes are fixed by Dirichlet conditions,
    and a finite-volume cell has one inner face alone. The result is empty where the grid is one cell wide, since a
    cell then has two corners of the grid.
    """
    along_xi, along_eta = shape
    if min(shape) < 2:
        return {}
    last = along_xi * along_eta - 1
    return {0: 0, along_eta - 1: 1, last - along_eta + 1: 1, last: 0}


def _smallest_angle(corners: Array) -> Array:
    """The smallest signed angle of triangles with ``corners`` of shape ``(..., 3, 2)``."""
    ahead, behind = np.roll(corners, -1, axis=-2) - corners, np.roll(corners, 1, axis=-2) - corners
    cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    angle: Array = np.arctan2(cross, (ahead * behind).sum(axis=-1)).min(axis=-1)
    return angle


def triangles_of(points: Array, shape: tuple[int, int]) -> IntArray:
    """The cells of a grid cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

    ``points`` are the nodes, shape ``(n_xi * n_eta, 2)``, ``shape`` is ``(n_xi, n_eta)``. Cell ``k`` gives the rows
    ``2 k`` and ``2 k + 1``. Each quadrilateral is cut along the diagonal that leaves the larger smallest angle, those
    at the four corners through the corner, so that no triangle has two edges on the boundary.
    """
    quads = quads_of(shape)
    cuts = better_cuts(points[quads], corner_cuts((shape[0] - 1, shape[1] - 1)))
    triangles: IntArray = np.take_along_axis(quads, CUTS[cuts].reshape(-1, 6), axis=1)
    return triangles.reshape(-1, 3)


def quads_of(shape: tuple[int, int]) -> IntArray:
    """The nodes of every quadrilateral of a grid of ``shape`` nodes, counter-clockwise, shape ``(m, 4)``."""
    n_xi, n_eta = shape
    first = (n_eta * np.arange(n_xi - 1)[:, None] + np.arange(n_eta - 1)).reshape(-1)
    corners = np.empty((first.size, 4), dtype=np.int64)
    for k, further in enumerate((0, n_eta, n_eta + 1, 1)):
        np.add(first, further, out=corners[:, k])
    return corners


def triangles_of_cells(points: Array, cells: IntArray) -> IntArray:
    """The quadrilaterals ``cells`` of any mesh cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

    As :func:`triangles_of`: a cell with two boundary edges that meet is cut through their common corner.
    """
    cuts = better_cuts(points[cells], cuts_at_corners(cells))
    triangles: IntArray = np.take_along_axis(cells, CUTS[cuts].reshape(-1, 6), axis=1)
    return triangles.reshape(-1, 3)


def quads_of_triangles(triangles: IntArray) -> IntArray:
    """The quadrilaterals that ``triangles`` of :func:`triangles_of_cells` were cut from, shape ``(m, 4)``.

    The corners of a cell begin where they began before the cut.
    """
    first, second = triangles[0::2], triangles[1::2]
    third = np.where(cuts_of_triangles(triangles) == 0, first[:, 2], second[:, 1])
    return np.column_stack([first[:, 0], first[:, 1], third, second[:, 2]])


def cuts_of_triangles(triangles: IntArray) -> IntArray:
    """The cut of each quadrilateral, 0 or 1 as in ``CUTS``, that ``triangles`` of shape ``(2 m, 3)`` were cut from."""
    cuts: IntArray = (triangles[0::2, 0] != triangles[1::2, 0]).astype(np.int64)
    return cuts


def cut_ends(triangles: IntArray) -> IntArray:
    """The two nodes of the cut of each quadrilateral that ``triangles`` were cut from, shape ``(m, 2)``."""
    first, cuts = triangles[0::2], cuts_of_triangles(triangles)
    return np.column_stack([np.where(cuts == 0, first[:, 0], first[:, 1]), first[:, 2]])


def cuts_at_corners(cells: IntArray) -> dict[int, int]:
    """The cells with two boundary edges that meet, and with no other one, each with the cut through that corner."""
    edges = np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1)  # edge k runs from corner k to k + 1
    ends = np.sort(edges.reshape(-1, 2), axis=1)
    _, places, counts = np.unique(ends[:, 0] * (cells.max() + 1) + ends[:, 1], return_inverse=True, return_counts=True)
    free = (counts[places] == 1).reshape(cells.shape)
    corner = free & np.roll(free, 1, axis=1)  # both edges of this corner are on the boundary
    found = np.flatnonzero((free.sum(axis=1) == 2) & corner.any(axis=1))
    return dict(zip(found.tolist(), (corner[found].argmax(axis=1) % 2).tolist(), strict=True))


__all__ = ["SIDES", "TAGS", "Array", "Cells", "HasParts", "IntArray", "MeshParts"]

Cells: TypeAlias = Literal["quad", "triangle"]

SIDES: Final = ("left", "right", "bottom", "top")
# The number of a side in libraries that know numbers only, and in files: the place in SIDES, from 1.
TAGS: Final = {side: number for number, side in enumerate(SIDES, start=1)}


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshParts:
    """A mesh as plain arrays.

    ``points`` are the coordinates of the nodes, shape ``(n, 2)``, where ``n`` is ``n_xi * n_eta`` and node ``(i, j)``
    has number ``i * n_eta + j``. ``cells`` are counter-clockwise, shape ``(m, 4)`` for quadrilaterals, ``(m, 3)`` for
    triangles; the triangles ``2 k`` and ``2 k + 1`` are cut from quadrilateral ``k``. ``sides`` has the edges of
    ``left``, ``right``, ``bottom`` and ``top``, in this order, shape ``(k, 2)`` each, with the domain on their left.
    ``shape`` is ``(n_xi, n_eta)``. A mesh of blocks has no such shape: ``shape`` is ``None`` there, nodes and cells
    have the numbers of that mesh, and ``sides`` has any names.
    """

    points: Array
    cells: IntArray
    sides: Mapping[str, IntArray]
    shape: tuple[int, int] | None

    @property
    def node_shape(self) -> tuple[int, ...]:
        """The shape of one value at each node: ``(n_xi, n_eta)``, or ``(n,)`` for a mesh of blocks."""
        return (len(self.points),) if self.shape is None else self.shape

    @property
    def cell_shape(self) -> tuple[int, ...]:
        """The shape of one value on each cell: ``(n_xi - 1, n_eta - 1)``, or ``(m,)`` for a mesh of blocks."""
        if self.shape is None:
            return (len(self.cells) // (2 if self.is_triangular else 1),)
        return self.shape[0] - 1, self.shape[1] - 1

    @property
    def is_triangular(self) -> bool:
        """Whether the cells are triangles."""
        return bool(self.cells.shape[1] == 3)

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """The same mesh with the kind of ``cells`` that is requested, ``"quad"`` or ``"triangle"``; else itself.

        Raises :class:`BadValues` for another kind.
        """
        if cells not in (None, "quad", "triangle"):
            raise BadValues(f"unknown kind of cells {cells!r}: choose quad or triangle")
        if cells is None or (cells == "triangle") == self.is_triangular:
            return self
        if self.shape is None:
            to_triangles = cells == "triangle"
            found = triangles_of_cells(self.points, self.cells) if to_triangles else quads_of_triangles(self.cells)
            return replace(self, cells=found)
        corners = triangles_of(self.points, self.shape) if cells == "triangle" else quads_of(self.shape)
        return replace(self, cells=corners)


class HasParts(Protocol):
    """A mesh that gives its parts: a mesh of the solver or of the client, or :class:`MeshParts`."""

    def mesh_parts(self, cells: Any = None) -> MeshParts:
        """The parts, with the kind of ``cells`` that is requested, or else the kind that the mesh has."""
        ...
