"""Compiled loops over the cells of a mesh: their corners, areas and determinants, and points inside them.

Nodes are arrays of rows. A cell has the number ``i * columns + j`` of its row i and column j, counted from the first of
these rows.
"""

from __future__ import annotations

import numpy as np

from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array, BoolArray, IntArray


@vectorised
def areas_of_row(x0: Array, x1: Array, y0: Array, y1: Array, area: Array, lowest: Array) -> None:
    """The areas of a row of cells; ``lowest`` becomes at most the smallest determinant at a corner of each cell."""
    for j in range(area.size):
        ex0, ey0, ex1, ey1 = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
        fx0, fy0, fx1, fy1 = x0[j + 1] - x0[j], y0[j + 1] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
        a, b = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
        c, d = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
        area[j] = 0.25 * (a + b + c + d)
        lowest[j] = min(lowest[j], min(min(a, b), min(c, d)))


@vectorised
def sum_of_row(row: Array) -> float:
    """The sum of some numbers."""
    total = 0.0
    for number in row:
        total += number
    return total


@compiled
def sum_of_rows(rows: Array) -> float:
    """The sum of some numbers, row by row, as other loops over rows add them."""
    total = 0.0
    for i in range(rows.shape[0]):
        total += sum_of_row(rows[i])
    return total


@compiled
def measure_cells(x: Array, y: Array, area: Array, valid: BoolArray) -> float:
    """The smallest determinant at a corner, NaN where a coordinate is not finite; area and validity of every cell."""
    columns, smallest, check = x.shape[1] - 1, np.inf, 0.0  # min ignores NaN, a sum does not
    lowest = np.empty(columns)
    for i in range(x.shape[0] - 1):
        areas, valids = area[i * columns : (i + 1) * columns], valid[i * columns : (i + 1) * columns]
        for j in range(columns):
            lowest[j] = np.inf
        areas_of_row(x[i], x[i + 1], y[i], y[i + 1], areas, lowest)
        for j in range(columns):
            valids[j] = lowest[j] > 0.0 and areas[j] - areas[j] == 0.0
        for j in range(columns):
            smallest = min(smallest, lowest[j])
        check += sum_of_row(areas)
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


# Compiled measures of every cell of some: of its shape, and of its shape in a metric.
#
# ``corners`` of shape ``(8, n)`` are x and then y of the corners, counter-clockwise; ``valid``, ``area`` and every
# result have one number for each cell. All results but the sine are those of valid cells, and infinite or 1 on
# folded ones.
# :mod:`equimesh.quality.measures` defines the measures.


@compiled
def shapes(corners: Array, valid: BoolArray, out: Array) -> None:
    """``Q_geo``, scaled Jacobian, tangent of the skewness and aspect ratio, in the rows of ``out``.

    Angles of a valid cell lie between 0 and 180 degrees, where the cotangent falls: the extreme ones need no others.
    The tangent, of the angle farthest from a right one minus that, is infinite on a folded cell.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    regularity, sine, tangent, aspect = out[0], out[1], out[2], out[3]
    for k in range(valid.size):
        ax, ay, bx, by = x1[k] - x0[k], y1[k] - y0[k], x2[k] - x1[k], y2[k] - y1[k]  # the edges, one after the other
        cx, cy, dx, dy = x3[k] - x2[k], y3[k] - y2[k], x0[k] - x3[k], y0[k] - y3[k]
        aa, bb, cc, dd = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy, dx * dx + dy * dy
        da, ab, bc, cd = dx * ay - dy * ax, ax * by - ay * bx, bx * cy - by * cx, cx * dy - cy * dx
        p, q, r, s = 1.0 / da, 1.0 / ab, 1.0 / bc, 1.0 / cd
        regularity[k] = 0.5 * max(max((dd + aa) * p, (aa + bb) * q), max((bb + cc) * r, (cc + dd) * s))
        p, q = -(dx * ax + dy * ay) * p, -(ax * bx + ay * by) * q
        r, s = -(bx * cx + by * cy) * r, -(cx * dx + cy * dy) * s
        tangent[k] = max(max(max(p, q), max(r, s)), -min(min(p, q), min(r, s)))
        p, q = da * abs(da) / (dd * aa), ab * abs(ab) / (aa * bb)  # the squares of the sines, with their signs
        r, s = bc * abs(bc) / (bb * cc), cd * abs(cd) / (cc * dd)
        p, q, r, s = p if p == p else 0.0, q if q == q else 0.0, r if r == r else 0.0, s if s == s else 0.0
        sine[k] = min(min(p, q), min(r, s))
        shortest, longest = min(min(aa, bb), min(cc, dd)), max(max(aa, bb), max(cc, dd))
        total = aa + bb + cc + dd
        aspect[k] = longest / shortest if shortest > 0.0 and total - total == 0.0 else np.inf
    for k in range(valid.size):
        sine[k] = np.sqrt(sine[k]) if sine[k] >= 0.0 else -np.sqrt(-sine[k])
        aspect[k] = np.sqrt(aspect[k])
        if not valid[k]:
            regularity[k] = tangent[k] = np.inf


@compiled
def shares_and_alignments(corners: Array, area: Array, valid: BoolArray, metric: Array, out: Array) -> None:
    """``|K| sqrt(det M_K)`` and ``Q_ali`` in the rows of ``out``, ``metric`` of shape ``(3, n)``.

    ``tr(F'^T M F') / det F'`` is largest at a corner: along s and along t the trace is quadratic and convex, the
    determinant linear and positive, and such a quotient is largest at an end.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    m11, m12, m22, share, alignment = metric[0], metric[1], metric[2], out[0], out[1]
    for k in range(valid.size):
        ax, ay, bx, by = x1[k] - x0[k], y1[k] - y0[k], x2[k] - x1[k], y2[k] - y1[k]
        cx, cy, dx, dy = x3[k] - x2[k], y3[k] - y2[k], x0[k] - x3[k], y0[k] - y3[k]
        aa = m11[k] * ax * ax + 2.0 * m12[k] * ax * ay + m22[k] * ay * ay
        bb = m11[k] * bx * bx + 2.0 * m12[k] * bx * by + m22[k] * by * by
        cc = m11[k] * cx * cx + 2.0 * m12[k] * cx * cy + m22[k] * cy * cy
        dd = m11[k] * dx * dx + 2.0 * m12[k] * dx * dy + m22[k] * dy * dy
        p, q = (dd + aa) / (dx * ay - dy * ax), (aa + bb) / (ax * by - ay * bx)
        r, s = (bb + cc) / (bx * cy - by * cx), (cc + dd) / (cx * dy - cy * dx)
        volume = np.sqrt(m11[k] * m22[k] - m12[k] * m12[k])
        share[k] = volume * area[k] if valid[k] else np.inf
        alignment[k] = max(max(p, q), max(r, s)) / (2.0 * volume) if valid[k] else np.inf


@compiled
def size_ratios_of(neighbours: IntArray, start: int, valid: BoolArray, area: Array, out: Array) -> None:
    """Larger area over smaller, the largest over the edge neighbours; infinite on folded cells and next to them.

    ``neighbours`` has four of each cell, shape ``(cells, 4)``, or -1. They, ``valid`` and ``area`` are those of all
    cells of the mesh; ``out`` belongs to the consecutive cells from number ``start`` on.
    """
    for k in range(out.size):
        here = start + k
        largest = smallest = area[here]
        known = valid[here]
        for j in range(4):
            other = neighbours[here, j]
            if other >= 0:
                largest, smallest = max(largest, area[other]), min(smallest, area[other])
                known = known and valid[other]
        out[k] = max(largest / area[here], area[here] / smallest) if known else np.inf
