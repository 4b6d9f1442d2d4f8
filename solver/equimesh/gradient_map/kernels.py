"""The compiled loops of the gradient map.

The potential ``phi`` has one value for each cell. A node moves by the gradient of the bilinear interpolant in the
middle of its four cells; beyond a side the values are those of the cells at the side, so nodes stay on their sides.
Cells that differ in turns, as on a chess board, move no node.
"""

import numpy as np

from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array


@compiled
def move_nodes(phi: Array, along: float, across: float, x: Array, y: Array) -> None:
    """Write the nodes of the reference square, shape ``(n_xi, n_eta)``, that the potential gives.

    ``along`` and ``across`` scale the two partial derivatives.
    """
    cells_xi, cells_eta = phi.shape
    by_xi, by_eta = 0.5 * along * cells_xi, 0.5 * across * cells_eta
    for i in range(cells_xi + 1):
        west, east = max(i - 1, 0), min(i, cells_xi - 1)
        for j in range(cells_eta + 1):
            south, north = max(j - 1, 0), min(j, cells_eta - 1)
            first = phi[east, north] - phi[west, south]
            second = phi[east, south] - phi[west, north]
            x[i, j] = i / cells_xi + by_xi * (first + second)
            y[i, j] = j / cells_eta + by_eta * (first - second)


@compiled
def measure_cells(x: Array, y: Array, area: Array) -> float:
    """Write the areas of the cells over that of a cell of the uniform mesh; returns the smallest corner Jacobian.

    The Jacobians have the same unit: all are 1 on the uniform mesh. The result is NaN where a node is not finite.
    """
    smallest, unit = np.inf, float(area.size)
    for i in range(area.shape[0]):
        for j in range(area.shape[1]):
            x00, x10, x11, x01 = x[i, j], x[i + 1, j], x[i + 1, j + 1], x[i, j + 1]
            y00, y10, y11, y01 = y[i, j], y[i + 1, j], y[i + 1, j + 1], y[i, j + 1]
            a = (x10 - x00) * (y01 - y00) - (x01 - x00) * (y10 - y00)
            b = (x10 - x00) * (y11 - y10) - (x11 - x10) * (y10 - y00)
            c = (x11 - x01) * (y11 - y10) - (x11 - x10) * (y11 - y01)
            d = (x11 - x01) * (y01 - y00) - (x01 - x00) * (y11 - y01)
            area[i, j] = 0.25 * (a + b + c + d) * unit
            if np.isnan(area[i, j]):
                return np.nan
            smallest = min(smallest, a, b, c, d)
    return smallest * unit


@compiled
def look_up(table: Array, x: Array, y: Array, out: Array) -> None:
    """Write the densities at the centres of the cells with these nodes, from a ``table`` over the unit square."""
    last_xi, last_eta = table.shape[0] - 1, table.shape[1] - 1
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            a = 0.25 * (x[i, j] + x[i + 1, j] + x[i + 1, j + 1] + x[i, j + 1]) * last_xi
            b = 0.25 * (y[i, j] + y[i + 1, j] + y[i + 1, j + 1] + y[i, j + 1]) * last_eta
            k, m = min(max(int(a), 0), last_xi - 1), min(max(int(b), 0), last_eta - 1)
            s, t = a - k, b - m
            low = (1.0 - s) * table[k, m] + s * table[k + 1, m]
            high = (1.0 - s) * table[k, m + 1] + s * table[k + 1, m + 1]
            out[i, j] = (1.0 - t) * low + t * high


@compiled
def average(values: Array, work: Array, mirrored: bool) -> None:
    """Average ``values`` over neighbours in both directions, with weights 1/4, 1/2, 1/4; ``work`` is overwritten.

    Beyond a side lies the value at the side, or the second one if ``mirrored``: that keeps the integral of values at
    cells, or at nodes.
    """
    rows, columns = values.shape
    shift = 1 if mirrored else 0
    for i in range(rows):
        before = i - 1 if i > 0 else shift
        after = i + 1 if i < rows - 1 else rows - 1 - shift
        for j in range(columns):
            work[i, j] = 0.25 * (values[before, j] + values[after, j]) + 0.5 * values[i, j]
    for i in range(rows):
        for j in range(columns):
            before = j - 1 if j > 0 else shift
            after = j + 1 if j < columns - 1 else columns - 1 - shift
            values[i, j] = 0.25 * (work[i, before] + work[i, after]) + 0.5 * work[i, j]


@vectorised
def product(one: Array, other: Array) -> float:
    """The inner product of two arrays of one shape, on one thread."""
    result = 0.0
    for i in range(one.shape[0]):
        for j in range(one.shape[1]):
            result += one[i, j] * other[i, j]
    return result
