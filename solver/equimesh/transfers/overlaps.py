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
from equimesh.transfers.clipping import MAX_CORNERS, clip_cell, moments
from equimesh.transfers.integrals import Cells, cells_of
from equimesh.transfers.quad_cells import QuadCells
from equimesh.transfers.quad_overlaps import USUAL_OVERLAPS, centroids_of, find_quad_overlaps, longer

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
        pairs = tuple((np.ascontiguousarray(m.x), np.ascontiguousarray(m.y)) for m in (old, new))
        first, cell, area, of_x, of_y = find_overlaps(pairs[0], pairs[1], (of_old.x, of_old.y))
        covered = np.add.reduceat(area, first[:-1])
        return cls(old=of_old, new=of_new, first=first, cell=cell, area=area, of_x=of_x, of_y=of_y, covered=covered)

    @classmethod
    def _of_quads(cls, old: QuadMesh, new: QuadMesh) -> Overlaps:
        """Those of two meshes of quadrilaterals; old cells beyond a periodic join count as themselves."""
        unrolled, of_old, of_new = Unrolled.of(old), QuadCells.of(old), QuadCells.of(new)
        nodes = np.array(new.x, dtype=float), np.array(new.y, dtype=float)
        found = find_quad_overlaps(unrolled.search, centroids_of(unrolled), nodes, np.ascontiguousarray(new.cells))
        first, cell, area, of_x, of_y = found
        covered, cell = np.add.reduceat(area, first[:-1]), cell % unrolled.cells
        return cls(old=of_old, new=of_new, first=first, cell=cell, area=area, of_x=of_x, of_y=of_y, covered=covered)

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


@compiled
def find_overlaps(old: Pair, new: Pair, centroids: Pair) -> tuple[IntArray, IntArray, Array, Array, Array]:
    """The arrays of :class:`Overlaps`: by steps from cell to neighbouring cell, from the one that holds the centre."""
    (x, y), (fine_x, fine_y) = old, new
    rows, columns = x.shape[0] - 1, x.shape[1] - 1
    new_rows, new_columns = fine_x.shape[0] - 1, fine_x.shape[1] - 1
    size, found = USUAL_OVERLAPS * new_rows * new_columns, 0
    first = np.zeros(new_rows * new_columns + 1, dtype=np.int64)
    cell, area = np.empty(size, dtype=np.int64), np.empty(size)
    of_x, of_y = np.empty(size), np.empty(size)
    seen = np.full(rows * columns, -1, dtype=np.int64)
    stack = np.empty(rows * columns, dtype=np.int64)
    quad, sides = np.empty((4, 2)), np.empty((4, 2))
    polygon, spare = np.empty((MAX_CORNERS + 8, 2)), np.empty((MAX_CORNERS + 8, 2))
    i = j = 0
    for n in range(new_rows * new_columns):
        row, column = n // new_columns, n % new_columns
        corners_of(fine_x, fine_y, row, column, 0.0, 0.0, quad)
        x0, y0 = quad[0, 0], quad[0, 1]  # areas of small cells are exact in coordinates from their own corner
        px = 0.25 * (quad[0, 0] + quad[1, 0] + quad[2, 0] + quad[3, 0])
        py = 0.25 * (quad[0, 1] + quad[1, 1] + quad[2, 1] + quad[3, 1])
        i, j = walk(px, py, x, y, i, j)
        corners_of(fine_x, fine_y, row, column, x0, y0, quad)
        left, right = (
            min(quad[0, 0], quad[1, 0], quad[2, 0], quad[3, 0]),
            max(quad[0, 0], quad[1, 0], quad[2, 0], quad[3, 0]),
        )
        low, high = (
            min(quad[0, 1], quad[1, 1], quad[2, 1], quad[3, 1]),
            max(quad[0, 1], quad[1, 1], quad[2, 1], quad[3, 1]),
        )
        stack[0], waiting, begin = i * columns + j, 1, found
        seen[stack[0]] = n
        while waiting > 0:
            waiting -= 1
            k = stack[waiting]
            r, c = k // columns, k % columns
            corners_of(x, y, r, c, x0, y0, sides)
            apart = (
                max(sides[0, 0], sides[1, 0], sides[2, 0], sides[3, 0]) < left
                or min(sides[0, 0], sides[1, 0], sides[2, 0], sides[3, 0]) > right
                or max(sides[0, 1], sides[1, 1], sides[2, 1], sides[3, 1]) < low
                or min(sides[0, 1], sides[1, 1], sides[2, 1], sides[3, 1]) > high
            )
            count = 0 if apart else clip_cell(quad, sides, polygon, spare)
            if count > 0:
                part, part_x, part_y = moments(polygon, count, centroids[0][k] - x0, centroids[1][k] - y0)
                if part > 0.0:
                    if found == size:
                        size *= 2
                        cell, area = longer(cell, size), longer(area, size)
                        of_x, of_y = longer(of_x, size), longer(of_y, size)
                    cell[found], area[found], of_x[found], of_y[found] = k, part, part_x, part_y
                    found += 1
            if count == 0 and k != i * columns + j:
                continue
            for step in range(4):
                to_r, to_c = r + (step == 0) - (step == 1), c + (step == 2) - (step == 3)
                if 0 <= to_r < rows and 0 <= to_c < columns and seen[to_r * columns + to_c] != n:
                    seen[to_r * columns + to_c] = n
                    stack[waiting] = to_r * columns + to_c
                    waiting += 1
        if found == begin:  # beyond the old mesh: the nearest cell stands for it
            if found == size:
                size *= 2
                cell, area = longer(cell, size), longer(area, size)
                of_x, of_y = longer(of_x, size), longer(of_y, size)
            cell[found], area[found], of_x[found], of_y[found] = i * columns + j, 0.0, 0.0, 0.0
            found += 1
        first[n + 1] = found
    return first, cell[:found], area[:found], of_x[:found], of_y[:found]


@compiled
def corners_of(x: Array, y: Array, i: int, j: int, x0: float, y0: float, quad: Array) -> None:
    """The corners of the cell (i, j), counter-clockwise, in coordinates from (x0, y0)."""
    quad[0, 0], quad[0, 1] = x[i, j] - x0, y[i, j] - y0
    quad[1, 0], quad[1, 1] = x[i + 1, j] - x0, y[i + 1, j] - y0
    quad[2, 0], quad[2, 1] = x[i + 1, j + 1] - x0, y[i + 1, j + 1] - y0
    quad[3, 0], quad[3, 1] = x[i, j + 1] - x0, y[i, j + 1] - y0
