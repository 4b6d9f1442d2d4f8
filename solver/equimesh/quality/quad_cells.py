"""The cells of a mesh of blocks as bilinear quadrilaterals: one row of cells after the other, in one column."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from equimesh.meshes.cell_edges import CellEdges
from equimesh.meshes.closed import OPEN, Closed
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_window import MeshWindow, WindowRows
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh.quality.cell_maps import gather_corners, measure_corners
from equimesh.quality.cell_shapes import size_ratios_of
from equimesh.quality.cells import BilinearCells, Block, MeshCells
from equimesh_coupling.cuts import cuts_at_corners

AnyMesh: TypeAlias = Mesh | MeshWindow | QuadMesh
"""A grid of nodes, the rows of one that a process holds, or a mesh of blocks."""


@dataclass(frozen=True, eq=False)
class QuadCells(MeshCells):
    """All cells of a mesh of blocks, with the numbers that they have there.

    They count as one column of cells, since they have no rows of more: sums go over runs of consecutive cells.
    """

    mesh: QuadMesh

    @cached_property
    def rows(self) -> WindowRows:
        """One column with all cells."""
        return WindowRows.whole((len(self.mesh.cells) + 1, 2))

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """x and y of the nodes, shape ``(n,)``."""
        return np.ascontiguousarray(self.mesh.x), np.ascontiguousarray(self.mesh.y)

    @property
    def area(self) -> Array:
        """Signed area of all cells, shape ``(m,)``."""
        return self._measured[0]

    @property
    def valid(self) -> BoolArray:
        """Whether each cell is not folded, shape ``(m,)``."""
        return self._measured[1]

    @property
    def lowest(self) -> float:
        """The smallest determinant of the Jacobian matrix at a corner; NaN where a coordinate is not finite."""
        return self._measured[2]

    @cached_property
    def total_area(self) -> float:
        """Signed area of the mesh."""
        return float(self.area.sum())

    @property
    def own_shape(self) -> tuple[int, ...]:
        """The shape of one value for each cell: ``(m,)``."""
        return (len(self.mesh.cells),)

    @property
    def cuts(self) -> dict[int, int]:
        """The cells that are cut through a corner of the domain."""
        return cuts_at_corners(self.mesh.cells)

    @cached_property
    def edges(self) -> CellEdges:
        """The edges, those of a periodic join once."""
        return CellEdges.of(self.mesh.cells, len(self.mesh.points), self.mesh.ties)

    def places(self, cells: slice) -> slice:
        """The same places: all cells are held."""
        return cells

    def corners(self, cells: Block) -> Array:
        """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""
        chosen = self.mesh.cells[cells]
        out = np.empty((8, len(chosen)))
        gather_corners(*self.nodes, np.ascontiguousarray(chosen), out)
        return out

    def corner_values(self, nodal: Array, cells: IntArray) -> Array:
        """Values at the nodes at the corners of ``cells``, counter-clockwise, shape ``(4, cells)``."""
        return np.ascontiguousarray(np.asarray(nodal)[self.mesh.cells[cells]].T)

    def size_ratios(self, cells: slice, out: Array) -> None:
        """Larger area over smaller of consecutive cells, the largest over the neighbours; infinite on folded cells."""
        size_ratios_of(self._neighbours, cells.start, self.valid, self.area, out)

    @cached_property
    def _neighbours(self) -> IntArray:
        return np.ascontiguousarray(self.edges.neighbours)

    @cached_property
    def _measured(self) -> tuple[Array, BoolArray, float]:
        count = len(self.mesh.cells)
        area, valid = np.empty(count), np.empty(count, dtype=np.bool_)
        return area, valid, measure_corners(self.corners(slice(0, count)), area, valid)


def cells_of(mesh: AnyMesh, closed: Closed = OPEN) -> BilinearCells | QuadCells:
    """The cells of any mesh; lines of a grid may be ``closed``."""
    return QuadCells(mesh) if isinstance(mesh, QuadMesh) else BilinearCells(mesh, closed)
