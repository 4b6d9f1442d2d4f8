"""Compiled measures of every cell of some: of its shape, and of its shape in a metric.

``corners`` of shape ``(8, n)`` are x and then y of the corners, counter-clockwise; ``valid``, ``area`` and every result
have one number for each cell. All results but the sine are those of valid cells, and infinite or 1 on folded ones.
:mod:`equimesh.quality.measures` defines the measures.
"""

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray


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
def size_ratios(columns: int, start: int, valid: BoolArray, area: Array, out: Array) -> None:
    """Larger area over smaller, the largest over the edge neighbours; infinite on folded cells and next to them.

    ``valid`` and ``area`` are those of all cells of the mesh, with ``columns`` cells along eta; ``out`` belongs to the
    consecutive cells from number ``start`` on.
    """
    k = 0
    while k < out.size:
        first = start + k
        column = first % columns
        count = min(columns - column, out.size - k)
        for m in range(count):
            here = first + m
            largest = smallest = area[here]
            known = valid[here]
            if column + m > 0:
                largest, smallest = max(largest, area[here - 1]), min(smallest, area[here - 1])
                known = known and valid[here - 1]
            if column + m < columns - 1:
                largest, smallest = max(largest, area[here + 1]), min(smallest, area[here + 1])
                known = known and valid[here + 1]
            if here >= columns:
                largest, smallest = max(largest, area[here - columns]), min(smallest, area[here - columns])
                known = known and valid[here - columns]
            if here + columns < area.size:
                largest, smallest = max(largest, area[here + columns]), min(smallest, area[here + columns])
                known = known and valid[here + columns]
            out[k + m] = max(largest / area[here], area[here] / smallest) if known else np.inf
        k += count


@compiled
def size_ratios_of(neighbours: IntArray, start: int, valid: BoolArray, area: Array, out: Array) -> None:
    """As :func:`size_ratios` for any cells: ``neighbours`` has four of each, shape ``(cells, 4)``, or -1."""
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
