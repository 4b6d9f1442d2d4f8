"""Limited slopes by the averages over the cells of a mesh of quadrilaterals."""

import numpy as np

from equimesh.meshes.quad_links import QuadLinks
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.quad_cells import QuadCells
from equimesh.transfers.slopes import gradient, limiter


def slopes_of_quads(cells: QuadCells, averages: Array, least: float, most: float) -> tuple[Pair, Pair]:
    """The slopes in each cell by the averages of its neighbours, and the bounds that the cell keeps.

    As :func:`~equimesh.transfers.slopes.slopes_of_averages` where opposite neighbours stand for those along a line,
    and the cells around the corners for the 3 x 3 cells around.
    """
    count = averages.size
    beyond = np.empty((3, count, 4))
    continue_quads(cells.links, (cells.x, cells.y), averages, cells.corners, beyond)
    slopes, bounds = (np.empty(count), np.empty(count)), (np.empty(count), np.empty(count))
    limit_quads(cells.links, (cells.x, cells.y), averages, cells.corners, (least, most), beyond, (slopes, bounds))
    return slopes, bounds


@compiled
def continue_quads(links: QuadLinks, centroids: Pair, averages: Array, corners: Array, beyond: Array) -> None:
    """Fill in the centroid and the average beyond each edge, shape ``(3, cells, 4)``; continued at the boundary.

    There the centroid is mirrored, and the change is the smaller one of the last two along the line, 0 where they have
    different signs. Beyond a periodic join the centroid is that of the translated neighbour.
    """
    (x, y), neighbours = centroids, links.neighbours
    for cell in range(averages.size):
        for edge in range(4):
            to, after = neighbours[cell, edge], (edge + 1) % 4
            if to >= 0:
                back = edge_to(neighbours, to, cell)
                ahead = (back + 1) % 4
                for axis in range(2):
                    apart = corners[axis, cell, edge] + corners[axis, cell, after]
                    apart -= corners[axis, to, ahead] + corners[axis, to, back]
                    beyond[axis, cell, edge] = centroids[axis][to] + 0.5 * apart
                beyond[2, cell, edge] = averages[to]
            else:  # where one cell lies between two sides, this stays
                beyond[0, cell, edge] = corners[0, cell, edge] + corners[0, cell, after] - x[cell]
                beyond[1, cell, edge] = corners[1, cell, edge] + corners[1, cell, after] - y[cell]
                beyond[2, cell, edge] = averages[cell]
    for cell in range(averages.size):
        for edge in range(4):
            two = neighbours[cell, (edge + 2) % 4]
            if neighbours[cell, edge] >= 0 or two < 0:
                continue
            px, py = x[cell] - beyond[0, cell, (edge + 2) % 4], y[cell] - beyond[1, cell, (edge + 2) % 4]
            beyond[0, cell, edge], beyond[1, cell, edge] = x[cell] + px, y[cell] + py
            last = (edge_to(neighbours, two, cell) + 2) % 4
            if neighbours[two, last] >= 0:
                here, before = averages[cell] - averages[two], averages[two] - beyond[2, two, last]
                before *= np.hypot(px, py) / np.hypot(x[two] - beyond[0, two, last], y[two] - beyond[1, two, last])
                if here * before > 0.0:
                    beyond[2, cell, edge] = averages[cell] + (here if abs(here) < abs(before) else before)


@compiled
def edge_to(neighbours: IntArray, cell: int, to: int) -> int:
    """The edge of a cell beyond which its neighbour ``to`` lies."""
    for edge in range(3):
        if neighbours[cell, edge] == to:
            return edge
    return 3


@compiled
def limit_quads(
    links: QuadLinks,
    centroids: Pair,
    averages: Array,
    corners: Array,
    ends: tuple[float, float],
    beyond: Array,
    found: tuple[Pair, Pair],
) -> None:
    """Fill in the slopes and bounds of :func:`slopes_of_quads`."""
    (x, y), (slopes, bounds) = centroids, found
    room = np.empty(2)
    for cell in range(averages.size):
        mean = averages[cell]
        lowest = highest = mean
        for corner in range(4):
            node = links.cells[cell, corner]
            for at in range(links.starts[node], links.starts[node + 1]):
                other, place = links.places[at] // 4, links.places[at] % 4
                one, two = beyond[2, other, place], beyond[2, other, (place + 3) % 4]
                lowest, highest = min(lowest, averages[other]), max(highest, averages[other])
                is_one, is_two = links.neighbours[other, place] < 0, links.neighbours[other, (place + 3) % 4] < 0
                if is_one:
                    lowest, highest = min(lowest, one), max(highest, one)
                if is_two:
                    lowest, highest = min(lowest, two), max(highest, two)
                if is_one and is_two:
                    both = one + two - averages[other]
                    lowest, highest = min(lowest, both), max(highest, both)
        room[0], room[1] = max(lowest, ends[0]), min(highest, ends[1])
        at_x, at_y, values = beyond[0, cell], beyond[1, cell], beyond[2, cell]
        gx, gy = gradient(
            at_x[1] - at_x[3], at_y[1] - at_y[3], values[1] - values[3],
            at_x[2] - at_x[0], at_y[2] - at_y[0], values[2] - values[0],
        )  # fmt: skip
        factor = limiter(mean, gx, gy, (corners[0, cell], corners[1, cell]), (x[cell], y[cell]), room)
        slopes[0][cell], slopes[1][cell] = factor * gx, factor * gy
        bounds[0][cell], bounds[1][cell] = room[0], room[1]
