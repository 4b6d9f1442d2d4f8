"""Compiled loops over the cells of a mesh: their corners, areas and determinants, and points inside them.

Nodes are arrays of rows. A cell has the number ``i * columns + j`` of its row i and column j, counted from the first of
these rows.
"""

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray


@compiled
def measure_cells(x: Array, y: Array, area: Array, valid: BoolArray) -> float:
    """The smallest determinant at a corner, NaN where a coordinate is not finite; area and validity of every cell."""
    columns = x.shape[1] - 1
    lowest, total = np.empty(columns), np.empty(columns)
    smallest, check = np.inf, 0.0  # min ignores NaN, a sum does not
    for i in range(x.shape[0] - 1):
        x0, x1, y0, y1 = x[i], x[i + 1], y[i], y[i + 1]
        areas, valids = area[i * columns : (i + 1) * columns], valid[i * columns : (i + 1) * columns]
        for j in range(columns):
            ex0, ey0, ex1, ey1 = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
            fx0, fy0, fx1, fy1 = x0[j + 1] - x0[j], y0[j + 1] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            a, b = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
            c, d = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
            total[j] = a + b + c + d
            lowest[j] = min(min(a, b), min(c, d))
            areas[j] = 0.25 * total[j]
            valids[j] = lowest[j] > 0.0 and total[j] - total[j] == 0.0
        for j in range(columns):
            smallest = min(smallest, lowest[j])
            check += total[j]
    return smallest if np.isfinite(check) else np.nan


@compiled
def gather_cells(x: Array, y: Array, cells: IntArray, out: Array) -> None:
    """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""
    columns = x.shape[1] - 1
    for k in range(cells.size):
        i = cells[k] // columns
        j = cells[k] - i * columns
        out[0, k], out[1, k], out[2, k], out[3, k] = x[i, j], x[i + 1, j], x[i + 1, j + 1], x[i, j + 1]
        out[4, k], out[5, k], out[6, k], out[7, k] = y[i, j], y[i + 1, j], y[i + 1, j + 1], y[i, j + 1]


@compiled
def gather_row_of_cells(x: Array, y: Array, start: int, out: Array) -> None:
    """The same of consecutive cells from number ``start`` on."""
    columns, k = x.shape[1] - 1, 0
    while k < out.shape[1]:
        i = (start + k) // columns
        j = start + k - i * columns
        count = min(columns - j, out.shape[1] - k)
        for part, q in ((0, x), (4, y)):
            for m in range(count):
                out[part, k + m] = q[i, j + m]
                out[part + 1, k + m] = q[i + 1, j + m]
                out[part + 2, k + m] = q[i + 1, j + m + 1]
                out[part + 3, k + m] = q[i, j + m + 1]
        k += count


@compiled
def gather_values(nodal: Array, cells: IntArray, out: Array) -> None:
    """Nodal values at the corners of ``cells``, counter-clockwise."""
    columns = nodal.shape[1] - 1
    for k in range(cells.size):
        i = cells[k] // columns
        j = cells[k] - i * columns
        out[0, k], out[1, k] = nodal[i, j], nodal[i + 1, j]
        out[2, k], out[3, k] = nodal[i + 1, j + 1], nodal[i, j + 1]


@compiled
def locate(corners: Array, s: Array, t: Array, x: Array, y: Array) -> None:
    """The places ``x``, ``y`` of the points (s, t) in cells with these ``corners``, of shape ``(points, cells)``."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    for p in range(s.size):
        u, v = s[p], t[p]
        a, b, c, d = (1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v
        x_p, y_p = x[p], y[p]
        for k in range(corners.shape[1]):
            x_p[k] = a * x0[k] + b * x1[k] + c * x2[k] + d * x3[k]
            y_p[k] = a * y0[k] + b * y1[k] + c * y2[k] + d * y3[k]


@compiled
def map_cells(corners: Array, s: Array, t: Array, out: Array) -> None:
    """The entries of a :class:`CellMap`, in its order, of cells with these ``corners`` at the points (s, t)."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    for p in range(s.size):
        u, v = s[p], t[p]
        a, b, c, d = (1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v
        x, y, det = out[0, p], out[1, p], out[6, p]
        x_s, y_s, x_t, y_t = out[2, p], out[3, p], out[4, p], out[5, p]
        for k in range(corners.shape[1]):
            x[k] = a * x0[k] + b * x1[k] + c * x2[k] + d * x3[k]
            y[k] = a * y0[k] + b * y1[k] + c * y2[k] + d * y3[k]
        for k in range(corners.shape[1]):
            x_s[k] = (1.0 - v) * (x1[k] - x0[k]) + v * (x2[k] - x3[k])
            y_s[k] = (1.0 - v) * (y1[k] - y0[k]) + v * (y2[k] - y3[k])
            x_t[k] = (1.0 - u) * (x3[k] - x0[k]) + u * (x2[k] - x1[k])
            y_t[k] = (1.0 - u) * (y3[k] - y0[k]) + u * (y2[k] - y1[k])
        for k in range(corners.shape[1]):
            det[k] = x_s[k] * y_t[k] - x_t[k] * y_s[k]


@compiled
def measure_corners(corners: Array, area: Array, valid: BoolArray) -> float:
    """As :func:`measure_cells` for any cells with these ``corners``, shape ``(8, cells)``."""
    smallest, check = np.inf, 0.0
    for k in range(area.size):
        x0, x1, x2, x3 = corners[0, k], corners[1, k], corners[2, k], corners[3, k]
        y0, y1, y2, y3 = corners[4, k], corners[5, k], corners[6, k], corners[7, k]
        a = (x1 - x0) * (y3 - y0) - (y1 - y0) * (x3 - x0)
        b = (x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1)
        c = (x2 - x3) * (y2 - y1) - (y2 - y3) * (x2 - x1)
        d = (x2 - x3) * (y3 - y0) - (y2 - y3) * (x3 - x0)
        total, lowest = a + b + c + d, min(min(a, b), min(c, d))
        area[k] = 0.25 * total
        valid[k] = lowest > 0.0 and total - total == 0.0
        smallest = min(smallest, lowest)
        check += total
    return smallest if np.isfinite(check) else np.nan


@compiled
def gather_corners(x: Array, y: Array, cells: IntArray, out: Array) -> None:
    """x and then y of the corners of any ``cells``, shape ``(cells, 4)``, into ``out`` of shape ``(8, cells)``."""
    for k in range(len(cells)):
        for j in range(4):
            out[j, k], out[4 + j, k] = x[cells[k, j]], y[cells[k, j]]
