"""Limited slopes: a linear function in each cell, with the cell's average, within bounds."""

from __future__ import annotations

import numpy as np

from equimesh.meshes.cell_edges import QuadLinks
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.transfers.integrals import Cells

# A pair of differences of centroids spans at least this share of the product of their squares, or the slope is zero.
MIN_SPAN = 1e-14


def slopes_of_averages(cells: Cells, averages: Array, least: float, most: float) -> tuple[Pair, Pair]:
    """The slopes in each cell by the averages of its neighbours, and the bounds that the cell keeps; all flat.

    The gradient is that of the differences of the averages of opposite neighbours, which is exact for linear functions.
    It is multiplied by the largest number in [0, 1] for which the values at the corners lie between the least and the
    largest average of the cells around the corners, 3 x 3 on a grid (T. J. Barth and D. C. Jespersen, AIAA 89-0366,
    1989), and between ``least`` and ``most``. Beyond a side the averages are continued by the smaller of the last two
    differences. A linear function is therefore exact at a straight row of centroids where ``least`` and ``most`` leave
    room. Where they are the least and the largest average, the slopes of the cells with these are reduced, and so are
    the nearby ones at a side.
    """
    count = averages.size
    beyond = np.empty((3, count, 4))
    continue_beyond(cells.links, (cells.x, cells.y), averages, cells.corners, beyond)
    slopes, bounds = (np.empty(count), np.empty(count)), (np.empty(count), np.empty(count))
    limit_averages(cells.links, (cells.x, cells.y), averages, cells.corners, (least, most), beyond, (slopes, bounds))
    return slopes, bounds


def slopes_of_nodes(cells: Cells, of_corners: Array, averages: Array) -> Pair:
    """The slopes in each cell by the values at its corners, shape ``(cells, 4)``; flat.

    The gradient is the mean of that of the bilinear function, multiplied by the largest number in [0, 1] for which the
    values of the linear function at the corners lie between the least and the largest of the four given ones.
    """
    slope_x, slope_y = np.empty(averages.size), np.empty(averages.size)
    limit_nodes((cells.x, cells.y), averages, of_corners, cells.corners, (slope_x, slope_y))
    return slope_x, slope_y


@compiled
def gradient(ax: float, ay: float, a: float, bx: float, by: float, b: float) -> tuple[float, float]:
    """The gradient whose products with two vectors are ``a`` and ``b``; zero where they are almost parallel."""
    det = ax * by - ay * bx
    if not abs(det) > MIN_SPAN * (ax * ax + ay * ay + bx * bx + by * by):
        return 0.0, 0.0
    return (a * by - b * ay) / det, (b * ax - a * bx) / det


@compiled
def limiter(mean: float, gx: float, gy: float, corners: Pair, centre: tuple[float, float], ends: Array) -> float:
    """The largest factor in [0, 1] of a gradient for which the values at the corners lie between the two ``ends``."""
    factor = 1.0
    for corner in range(4):
        change = gx * (corners[0][corner] - centre[0]) + gy * (corners[1][corner] - centre[1])
        room = ends[1] - mean if change > 0.0 else ends[0] - mean
        if abs(room) < factor * abs(change):
            factor = room / change
    return max(factor, 0.0)


@compiled
def limit_nodes(centroids: Pair, averages: Array, values: Array, corners: Array, slopes: Pair) -> None:
    """Fill in the slopes of :func:`slopes_of_nodes`: the mean gradient is that of the differences along diagonals."""
    room = np.empty(2)
    for k in range(averages.size):
        x, y, u = corners[0, k], corners[1, k], values[k]
        gx, gy = gradient(x[2] - x[0], y[2] - y[0], u[2] - u[0], x[3] - x[1], y[3] - y[1], u[3] - u[1])
        room[0], room[1] = min(u[0], u[1], u[2], u[3]), max(u[0], u[1], u[2], u[3])
        factor = limiter(averages[k], gx, gy, (x, y), (centroids[0][k], centroids[1][k]), room)
        slopes[0][k], slopes[1][k] = factor * gx, factor * gy


# The loops of limited slopes by averages over cells.


@compiled
def continue_beyond(links: QuadLinks, centroids: Pair, averages: Array, corners: Array, beyond: Array) -> None:
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
def limit_averages(
    links: QuadLinks,
    centroids: Pair,
    averages: Array,
    corners: Array,
    ends: tuple[float, float],
    beyond: Array,
    found: tuple[Pair, Pair],
) -> None:
    """Fill in the slopes and bounds of :func:`slopes_of_averages`."""
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
