"""Compiled measures of the shape of every cell of a mesh.

``x`` and ``y`` are the nodes, C-contiguous, of shape ``(n_xi, n_eta)``; ``valid``, ``area`` and all results are flat
arrays over the cells. :mod:`equimesh.quality.measures` defines the measures.
"""

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray


@compiled
def largest_ratio(x: Array, y: Array, i: int, j: int, m11: float, m12: float, m22: float) -> float:
    """``tr(F'^T M F') / det F'``, the largest over cell (i, j).

    It is found at a corner: along s and along t the trace is quadratic and convex, the determinant linear and
    positive, and such a quotient is largest at an end.
    """
    ex0, ey0 = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
    ex1, ey1 = x[i + 1, j + 1] - x[i, j + 1], y[i + 1, j + 1] - y[i, j + 1]
    fx0, fy0 = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
    fx1, fy1 = x[i + 1, j + 1] - x[i + 1, j], y[i + 1, j + 1] - y[i + 1, j]
    largest = 0.0
    for corner in range(4):
        ex, ey = (ex0, ey0) if corner < 2 else (ex1, ey1)
        fx, fy = (fx0, fy0) if corner & 1 else (fx1, fy1)
        trace = m11 * (ex * ex + fx * fx) + 2.0 * m12 * (ex * ey + fx * fy) + m22 * (ey * ey + fy * fy)
        largest = max(largest, trace / (ex * fy - ey * fx))
    return largest


@compiled
def alignments(x: Array, y: Array, valid: BoolArray, m11: Array, m12: Array, m22: Array, out: Array) -> None:
    """``Q_ali`` in the metric of each cell; infinite on folded cells."""
    columns = x.shape[1] - 1
    for k in range(valid.size):
        if valid[k]:
            ratio = largest_ratio(x, y, k // columns, k % columns, m11[k], m12[k], m22[k])
            out[k] = ratio / (2.0 * np.sqrt(m11[k] * m22[k] - m12[k] * m12[k]))
        else:
            out[k] = np.inf


@compiled
def regularities(x: Array, y: Array, valid: BoolArray, out: Array) -> None:
    """``Q_geo``; infinite on folded cells."""
    columns = x.shape[1] - 1
    for k in range(valid.size):
        out[k] = 0.5 * largest_ratio(x, y, k // columns, k % columns, 1.0, 0.0, 1.0) if valid[k] else np.inf


@compiled
def angles_and_edges(x: Array, y: Array, valid: BoolArray, sine: Array, skewness: Array, aspect_ratio: Array) -> None:
    """Scaled Jacobian, equiangle skewness and aspect ratio.

    Angles of a valid cell lie between 0 and 180 degrees, where the cotangent falls: the extreme ones need no others.
    """
    columns = x.shape[1] - 1
    px, py, length = np.empty(5), np.empty(5), np.empty(5)  # the edge that leaves each corner; the last one again
    for k in range(valid.size):
        i, j = k // columns, k % columns
        px[1], py[1] = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
        px[2], py[2] = x[i + 1, j + 1] - x[i + 1, j], y[i + 1, j + 1] - y[i + 1, j]
        px[3], py[3] = x[i, j + 1] - x[i + 1, j + 1], y[i, j + 1] - y[i + 1, j + 1]
        px[4], py[4] = x[i, j] - x[i, j + 1], y[i, j] - y[i, j + 1]
        px[0], py[0] = px[4], py[4]
        for c in range(5):
            length[c] = np.sqrt(px[c] * px[c] + py[c] * py[c])
        lowest, widest, narrowest = np.inf, np.inf, -np.inf  # sine, and cotangents
        for c in range(4):
            cross, dot = px[c] * py[c + 1] - py[c] * px[c + 1], -(px[c] * px[c + 1] + py[c] * py[c + 1])
            product = length[c] * length[c + 1]
            here = cross / product if product > 0.0 else 0.0
            if not here >= lowest:  # also NaN
                lowest = here
            widest, narrowest = min(widest, dot / cross), max(narrowest, dot / cross)
        shortest, longest = min(length[1:]), max(length[1:])
        sine[k] = lowest
        if valid[k]:
            skewness[k] = np.arctan(max(narrowest, -widest)) / (0.5 * np.pi)  # of the angle farthest from a right one
        else:
            skewness[k] = 1.0
        aspect_ratio[k] = longest / shortest if shortest > 0.0 and np.isfinite(length[1:].sum()) else np.inf


@compiled
def size_ratios(rows: int, columns: int, valid: BoolArray, area: Array, out: Array) -> None:
    """Larger area over smaller, the largest over the edge neighbours; infinite on folded cells and next to them."""
    for k in range(valid.size):
        i, j = k // columns, k % columns
        largest = 1.0 if valid[k] else np.inf
        for side in range(4):
            other = k + (columns, -columns, 1, -1)[side]
            if (i + 1 < rows, i > 0, j + 1 < columns, j > 0)[side] and valid[k]:
                ratio = area[k] / area[other] if valid[other] else np.inf
                largest = max(largest, ratio, 1.0 / ratio)
        out[k] = largest
