"""The parts of a mesh that other libraries need: points, cells, and the edges of the four sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, Protocol, TypeAlias

from equimesh_coupling.cuts import Array, IntArray, quads_of, quads_of_triangles, triangles_of, triangles_of_cells
from equimesh_coupling.errors import BadValues

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
