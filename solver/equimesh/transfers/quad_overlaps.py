"""Which cells of two meshes, of grids or of blocks, meet, in what area, and with what first moments."""

from __future__ import annotations

from typing import TypeAlias, TypeVar

import numpy as np

from equimesh.meshes.quad_links import QuadLinks
from equimesh.meshes.quad_search import Boxes, find_cell
from equimesh.meshes.unrolled import Unrolled
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.clipping import MAX_CORNERS, clip_cell, moments
from equimesh.transfers.measures import measures_of

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
def starts_on_quads(old: Pair, search: tuple[QuadLinks, Boxes, IntArray], nodes: Pair, cells: IntArray) -> IntArray:
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
    more[: values.size] = values
    return more
