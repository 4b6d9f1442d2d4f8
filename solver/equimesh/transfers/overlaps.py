"""The common parts of the cells of two meshes: which cells meet, in what area, and with what first moments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np

from equimesh.meshes.cell_edges import QuadLinks
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import Boxes, find_cell
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.integrals import Cells, measures_of

# The common part of two convex cells: its area and its first moments.

# Corners, at most, of the common part of two quadrilaterals.
MAX_CORNERS = 8


@compiled
def clip_cell(quad: Array, sides: Array, polygon: Array, spare: Array) -> int:
    """Cut the convex quadrilateral ``quad``, shape (4, 2), with another one, ``sides``; both counter-clockwise.

    Returns the number of corners of the common part, which are in ``polygon`` afterwards, shape (MAX_CORNERS + 1, 2) or
    more. It is 0 where the two do not meet. ``spare`` has the shape of ``polygon``.
    """
    count = 4
    for k in range(4):
        polygon[k, 0], polygon[k, 1] = quad[k, 0], quad[k, 1]
    for k in range(4):
        count = clip_half_plane(polygon, count, sides[k], sides[(k + 1) % 4], spare)
        if count < 3:
            return 0
        for m in range(count):
            polygon[m, 0], polygon[m, 1] = spare[m, 0], spare[m, 1]
    return count


@compiled
def clip_half_plane(polygon: Array, count: int, begin: Array, end: Array, kept: Array) -> int:
    """Keep what lies on the left of a line. Returns the number of corners of ``kept`` (Sutherland and Hodgman)."""
    ex, ey = end[0] - begin[0], end[1] - begin[1]
    x0, y0 = polygon[count - 1, 0], polygon[count - 1, 1]
    d0, found = ex * (y0 - begin[1]) - ey * (x0 - begin[0]), 0
    for m in range(count):
        x1, y1 = polygon[m, 0], polygon[m, 1]
        d1 = ex * (y1 - begin[1]) - ey * (x1 - begin[0])
        if (d0 < 0.0) != (d1 < 0.0):
            share = d0 / (d0 - d1)
            kept[found, 0], kept[found, 1] = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
            found += 1
        if d1 >= 0.0:
            kept[found, 0], kept[found, 1] = x1, y1
            found += 1
        x0, y0, d0 = x1, y1, d1
    return found


@compiled
def moments(polygon: Array, count: int, cx: float, cy: float) -> tuple[float, float, float]:
    """The area of a convex polygon, and the integrals of x - cx and of y - cy over it."""
    area = of_x = of_y = 0.0
    x0, y0 = polygon[0, 0], polygon[0, 1]
    for m in range(1, count - 1):
        ax, ay = polygon[m, 0] - x0, polygon[m, 1] - y0
        bx, by = polygon[m + 1, 0] - x0, polygon[m + 1, 1] - y0
        triangle = 0.5 * (ax * by - ay * bx)
        area += triangle
        of_x += triangle * (x0 - cx + (ax + bx) / 3.0)
        of_y += triangle * (y0 - cy + (ay + by) / 3.0)
    return area, of_x, of_y


# Which cells of two meshes, of grids or of blocks, meet, in what area, and with what first moments.

Numbers = TypeVar("Numbers", Array, IntArray)
Parts: TypeAlias = tuple[IntArray, IntArray, Array, Array, Array]
"""``first``, ``cell``, ``area``, ``of_x`` and ``of_y`` of :class:`~equimesh.transfers.overlaps.Overlaps`."""

# Old cells that meet one new cell, for the first size of the arrays.
USUAL_OVERLAPS = 12


def centroids_of(unrolled: Unrolled) -> Pair:
    """The centroids of the cells of a mesh and of its copies."""
    (x, y), cells = unrolled.search.nodes, unrolled.search.links.cells
    found = measures_of(np.stack([x[cells], y[cells]]))
    return found.x, found.y


@compiled
def starts_in(old: Pair, search: tuple[QuadLinks, Boxes, IntArray], nodes: Pair, cells: IntArray) -> IntArray:
    """The old cell that holds the centre of each of the new ``cells`` over ``nodes``, or the nearest one."""
    links, boxes, edges = search
    starts, quad, start = np.empty(cells.shape[0], dtype=np.int64), np.empty((4, 2)), 0
    for n in range(cells.shape[0]):
        x0, y0 = nodes[0][cells[n, 0]], nodes[1][cells[n, 0]]
        corners_from(nodes, cells[n], x0, y0, quad)
        px, py = x0 + 0.25 * quad[:, 0].sum(), y0 + 0.25 * quad[:, 1].sum()
        start = starts[n] = find_cell(px, py, old, links, boxes, edges, start)
    return starts


@compiled
def common_parts(
    old: Pair, links: tuple[IntArray, IntArray], centroids: Pair, starts: IntArray, nodes: Pair, cells: IntArray
) -> Parts:
    """By steps from cell to neighbouring cell, from the old cell that ``starts`` has for each of the new ``cells``.

    ``links`` are the corners of the old cells and their neighbours, both of shape ``(m, 4)``. A new
    cell that meets none has the old one of its start, with the area 0.
    """
    old_cells, neighbours = links
    count = old_cells.shape[0]
    size, found = USUAL_OVERLAPS * cells.shape[0], 0
    first, cell, area = np.zeros(cells.shape[0] + 1, dtype=np.int64), np.empty(size, dtype=np.int64), np.empty(size)
    of_x, of_y = np.empty(size), np.empty(size)
    seen, stack = np.full(count, -1, dtype=np.int64), np.empty(count, dtype=np.int64)
    quad, sides = np.empty((4, 2)), np.empty((4, 2))
    polygon, spare = np.empty((MAX_CORNERS + 8, 2)), np.empty((MAX_CORNERS + 8, 2))
    for n in range(cells.shape[0]):
        x0, y0 = nodes[0][cells[n, 0]], nodes[1][cells[n, 0]]  # areas of small cells are exact from their own corner
        low, high = corners_from(nodes, cells[n], x0, y0, quad)
        start = starts[n]
        stack[0], waiting, begin = start, 1, found
        seen[start] = n
        while waiting > 0:
            waiting -= 1
            k = stack[waiting]
            least, most = corners_from(old, old_cells[k], x0, y0, sides)
            apart = most[0] < low[0] or least[0] > high[0] or most[1] < low[1] or least[1] > high[1]
            corners = 0 if apart else clip_cell(quad, sides, polygon, spare)
            if corners > 0:
                part, part_x, part_y = moments(polygon, corners, centroids[0][k] - x0, centroids[1][k] - y0)
                if part > 0.0:
                    if found == size:
                        size *= 2
                        cell, area = longer(cell, size), longer(area, size)
                        of_x, of_y = longer(of_x, size), longer(of_y, size)
                    cell[found], area[found], of_x[found], of_y[found] = k, part, part_x, part_y
                    found += 1
            if corners == 0 and k != start:
                continue
            for edge in range(4):
                to = neighbours[k, edge]
                if to >= 0 and seen[to] != n:
                    seen[to], stack[waiting] = n, to
                    waiting += 1
        if found == begin:  # beyond the old mesh: the nearest cell stands for it
            if found == size:
                size *= 2
                cell, area = longer(cell, size), longer(area, size)
                of_x, of_y = longer(of_x, size), longer(of_y, size)
            cell[found], area[found], of_x[found], of_y[found] = start, 0.0, 0.0, 0.0
            found += 1
        first[n + 1] = found
    return first, cell[:found], area[:found], of_x[:found], of_y[:found]


@compiled
def corners_from(
    nodes: Pair, corners: IntArray, x0: float, y0: float, quad: Array
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The corners of a cell in coordinates from (x0, y0), in ``quad``; the least and the largest of them."""
    for k in range(4):
        quad[k, 0], quad[k, 1] = nodes[0][corners[k]] - x0, nodes[1][corners[k]] - y0
    x, y = quad[:, 0], quad[:, 1]
    least = min(min(x[0], x[1]), min(x[2], x[3])), min(min(y[0], y[1]), min(y[2], y[3]))
    return least, (max(max(x[0], x[1]), max(x[2], x[3])), max(max(y[0], y[1]), max(y[2], y[3])))


@compiled
def longer(values: Numbers, size: int) -> Numbers:
    """The values at the beginning of a longer array."""
    more = np.empty(size, dtype=values.dtype)
    for k in range(values.size):  # an assigned slice takes the compiler seconds, for the words of an error
        more[k] = values[k]
    return more


# A cell whose covered share differs from 1 by more than rounding reaches beyond the old mesh, at a curved side.
MAX_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Overlaps:
    """The common parts of the cells of a ``new`` mesh with those of an ``old`` one, of straight-edged cells.

    Cells are numbered as in :class:`~equimesh.meshes.mesh.Mesh`. The parts of the new cell n are those from
    ``first[n]`` to ``first[n + 1] - 1``. Part p lies in the old cell ``cell[p]`` and has the area ``area[p]``. The
    integrals of x and y over it, from the centroid of that old cell, are ``of_x[p]`` and ``of_y[p]``.
    """

    old: Cells
    new: Cells
    first: IntArray
    cell: IntArray
    area: Array
    of_x: Array
    of_y: Array
    covered: Array
    """The area of each new cell that lies in the old mesh."""

    @classmethod
    def of(cls, old: Mesh, new: Mesh) -> Overlaps:
        """The common parts of the cells of two valid meshes; old cells beyond a periodic join count as themselves."""
        unrolled, of_old, of_new = Unrolled.of(old), Cells.of(old), Cells.of(new)
        search, cells = unrolled.search, np.ascontiguousarray(new.cells)
        nodes = np.array(np.ravel(new.x), dtype=float), np.array(np.ravel(new.y), dtype=float)
        starts = starts_in(search.nodes, (search.links, search.boxes, search.edges), nodes, cells)
        links = search.links.cells, search.links.neighbours
        first, cell, *moments = common_parts(search.nodes, links, centroids_of(unrolled), starts, nodes, cells)
        area, of_x, of_y = moments
        return cls(
            old=of_old,
            new=of_new,
            first=first,
            cell=cell % unrolled.cells,
            area=area,
            of_x=of_x,
            of_y=of_y,
            covered=np.add.reduceat(area, first[:-1]),
        )

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
