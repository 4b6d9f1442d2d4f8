"""The common parts of the cells of two meshes: which cells meet, in what area, and with what first moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.fields.mesh_map import walk
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.integrals import Cells, cells_of
from equimesh.transfers.quad_cells import QuadCells
from equimesh.transfers.quad_overlaps import Parts, centroids_of, common_parts, starts_on_quads

# A cell whose covered share differs from 1 by more than rounding reaches beyond the old mesh, at a curved side.
MAX_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlaps:
    """The common parts of the cells of a ``new`` mesh with those of an ``old`` one, of straight-edged cells.

    Cells are numbered as in :class:`~equimesh.meshes.mesh.Mesh`. The parts of the new cell n are those from
    ``first[n]`` to ``first[n + 1] - 1``. Part p lies in the old cell ``cell[p]`` and has the area ``area[p]``. The
    integrals of x and y over it, from the centroid of that old cell, are ``of_x[p]`` and ``of_y[p]``.
    """

    old: Cells | QuadCells
    new: Cells | QuadCells
    first: IntArray
    cell: IntArray
    area: Array
    of_x: Array
    of_y: Array
    covered: Array
    """The area of each new cell that lies in the old mesh."""

    @classmethod
    def of(cls, old: Mesh | QuadMesh, new: Mesh | QuadMesh) -> Overlaps:
        """The common parts of two valid meshes of one kind."""
        if isinstance(old, QuadMesh) and isinstance(new, QuadMesh):
            return cls._of_quads(old, new)
        if isinstance(old, QuadMesh) or isinstance(new, QuadMesh):
            raise AssertionError("the caller refuses meshes of two kinds")
        of_old, of_new = cells_of(old), cells_of(new)
        x, y, new_x, new_y = (np.ascontiguousarray(q, dtype=float) for q in (old.x, old.y, new.x, new.y))
        nodes, centroids = (new_x.reshape(-1), new_y.reshape(-1)), (of_old.x, of_old.y)
        starts = starts_on_grid((x, y), nodes, new.cells)
        links = old.cells, neighbours_on(of_old.shape)
        parts = common_parts((x.reshape(-1), y.reshape(-1)), links, centroids, starts, nodes, new.cells)
        return cls._of_parts(of_old, of_new, parts)

    @classmethod
    def _of_quads(cls, old: QuadMesh, new: QuadMesh) -> Overlaps:
        """Those of two meshes of quadrilaterals; old cells beyond a periodic join count as themselves."""
        unrolled, of_old, of_new = Unrolled.of(old), QuadCells.of(old), QuadCells.of(new)
        search, cells = unrolled.search, np.ascontiguousarray(new.cells)
        nodes = np.array(new.x, dtype=float), np.array(new.y, dtype=float)
        starts = starts_on_quads(search.nodes, (search.links, search.boxes, search.edges), nodes, cells)
        links = search.links.cells, search.links.neighbours
        parts = common_parts(search.nodes, links, centroids_of(unrolled), starts, nodes, cells)
        return cls._of_parts(of_old, of_new, (parts[0], parts[1] % unrolled.cells, *parts[2:]))

    @classmethod
    def _of_parts(cls, old: Cells | QuadCells, new: Cells | QuadCells, parts: Parts) -> Overlaps:
        first, cell, area, of_x, of_y = parts
        covered = np.add.reduceat(area, first[:-1])
        return cls(old=old, new=new, first=first, cell=cell, area=area, of_x=of_x, of_y=of_y, covered=covered)

    @property
    def beyond(self) -> Array:
        """The share of each new cell beyond the old mesh: 0 but for rounding where the sides are straight."""
        share = 1.0 - self.covered / self.new.area
        return np.where(np.abs(share) > MAX_ROUNDING, share, 0.0)

    def integrals(self, values: Array, slopes: Pair) -> Array:
        """The integral over each new cell of a function that is linear in each old one.

        ``values`` are its averages over the old cells. Where a new cell reaches beyond the old mesh, its mean there is
        that of the rest of the cell.
        """
        parts = self.area * values[self.cell]
        parts += slopes[0][self.cell] * self.of_x + slopes[1][self.cell] * self.of_y
        sums = np.add.reduceat(parts, self.first[:-1])
        outside = ~(self.covered > 0.0)  # such a cell has one part, of the nearest old cell
        covered = np.where(outside, 1.0, self.covered)
        means: Array = np.where(outside, values[self.cell[self.first[:-1]]], sums / covered)
        return self.new.area * means

    def bounds(self, lowest: Array, highest: Array) -> Pair:
        """The least and the largest number of the old cells that meet each new cell."""
        starts = self.first[:-1]
        return np.minimum.reduceat(lowest[self.cell], starts), np.maximum.reduceat(highest[self.cell], starts)


def neighbours_on(shape: tuple[int, int]) -> IntArray:
    """The cells after and before each cell of a grid, along xi and then along eta; -1 beyond a side."""
    numbers = np.pad(np.arange(shape[0] * shape[1]).reshape(shape), 1, constant_values=-1)
    after_before = numbers[2:, 1:-1], numbers[:-2, 1:-1], numbers[1:-1, 2:], numbers[1:-1, :-2]
    return np.stack(after_before, axis=-1).reshape(-1, 4)


@compiled
def starts_on_grid(old: Pair, nodes: Pair, cells: IntArray) -> IntArray:
    """The cell of an old grid that holds the centre of each new cell, or one near it."""
    (x, y), (new_x, new_y) = old, nodes
    starts = np.empty(cells.shape[0], dtype=np.int64)
    i = j = 0
    for n in range(cells.shape[0]):
        a, b, c, d = cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3]
        px, py = 0.25 * (new_x[a] + new_x[b] + new_x[c] + new_x[d]), 0.25 * (new_y[a] + new_y[b] + new_y[c] + new_y[d])
        i, j = walk(px, py, x, y, i, j)
        starts[n] = i * (x.shape[1] - 1) + j
    return starts
