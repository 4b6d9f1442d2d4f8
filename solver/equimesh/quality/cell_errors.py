"""Compiled integrals over cells: of a metric, and of the squared errors of bilinear interpolation.

``corners`` of shape ``(8, n)`` are x and then y of the corners of the cells, counter-clockwise; ``values`` of shape
``(4, n)`` are those of the interpolant there. Functions at points have the shape ``(points, n)``.
"""

from __future__ import annotations

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, Pair
from equimesh.quality.cells import CellPoints

MIDDLE_WEIGHT = 2 / 45
"""Weight of the middles of the edges; see :meth:`equimesh.quality.interpolation.ErrorRule.lean`."""


@compiled
def mean_metrics(
    corners: Array, area: Array, points: CellPoints, metric: tuple[Array, Array, Array], out: Array
) -> None:
    """The mean of ``metric`` over every cell, by quadrature; ``out`` has the shape ``(3, n)``."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    s, t, weights = points
    out[:] = 0.0
    first, second, third = out[0], out[1], out[2]
    for p in range(s.size):
        u, v, weight = s[p], t[p], weights[p]
        m11, m12, m22 = metric[0][p], metric[1][p], metric[2][p]
        for k in range(area.size):
            x_s = (1.0 - v) * (x1[k] - x0[k]) + v * (x2[k] - x3[k])
            y_s = (1.0 - v) * (y1[k] - y0[k]) + v * (y2[k] - y3[k])
            x_t = (1.0 - u) * (x3[k] - x0[k]) + u * (x2[k] - x1[k])
            y_t = (1.0 - u) * (y3[k] - y0[k]) + u * (y2[k] - y1[k])
            share = weight * (x_s * y_t - x_t * y_s) / area[k]
            first[k] += share * m11[k]
            second[k] += share * m12[k]
            third[k] += share * m22[k]


@compiled
def add_errors(
    corners: Array, values: Array, u: Array, gradient: Pair, points: CellPoints, sums: Array, largest: Array
) -> None:
    """To ``sums`` of shape ``(4, n)`` the integrals of errors ``u_h - u`` over every cell, by quadrature.

    The first is that of the squared error, the second that of the squared error of the gradient, the others are those
    of the two components of this error. ``largest`` becomes the largest size of the error.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    v0, v1, v2, v3 = values[0], values[1], values[2], values[3]
    squares, slopes, along_x, along_y = sums[0], sums[1], sums[2], sums[3]
    for p in range(u.shape[0]):
        s, t, weight = points.s[p], points.t[p], points.weights[p]
        a, b, c, d = (1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t
        here, u_x, u_y = u[p], gradient[0][p], gradient[1][p]
        for k in range(largest.size):
            x_s = (1.0 - t) * (x1[k] - x0[k]) + t * (x2[k] - x3[k])
            y_s = (1.0 - t) * (y1[k] - y0[k]) + t * (y2[k] - y3[k])
            x_t = (1.0 - s) * (x3[k] - x0[k]) + s * (x2[k] - x1[k])
            y_t = (1.0 - s) * (y3[k] - y0[k]) + s * (y2[k] - y1[k])
            det = x_s * y_t - x_t * y_s
            along_s = (1.0 - t) * (v1[k] - v0[k]) + t * (v2[k] - v3[k])
            along_t = (1.0 - s) * (v3[k] - v0[k]) + s * (v2[k] - v1[k])
            error = a * v0[k] + b * v1[k] + c * v2[k] + d * v3[k] - here[k]
            error_x = (along_s * y_t - along_t * y_s) / det - u_x[k]
            error_y = (along_t * x_s - along_s * x_t) / det - u_y[k]
            share = weight * det
            squares[k] += share * error * error
            slopes[k] += share * (error_x * error_x + error_y * error_y)
            along_x[k] += share * error_x
            along_y[k] += share * error_y
            largest[k] = max(largest[k], abs(error))


@compiled
def add_values(corners: Array, values: Array, u: Array, points: CellPoints, sums: Array, largest: Array) -> None:
    """To ``sums`` of every cell the integral of the squared error alone; ``largest`` as in :func:`add_errors`."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    v0, v1, v2, v3 = values[0], values[1], values[2], values[3]
    for p in range(u.shape[0]):
        s, t, weight = points.s[p], points.t[p], points.weights[p]
        a, b, c, d = (1.0 - s) * (1.0 - t), s * (1.0 - t), s * t, (1.0 - s) * t
        here = u[p]
        for k in range(largest.size):
            x_s = (1.0 - t) * (x1[k] - x0[k]) + t * (x2[k] - x3[k])
            y_s = (1.0 - t) * (y1[k] - y0[k]) + t * (y2[k] - y3[k])
            x_t = (1.0 - s) * (x3[k] - x0[k]) + s * (x2[k] - x1[k])
            y_t = (1.0 - s) * (y3[k] - y0[k]) + s * (y2[k] - y1[k])
            error = a * v0[k] + b * v1[k] + c * v2[k] + d * v3[k] - here[k]
            sums[k] += weight * (x_s * y_t - x_t * y_s) * error * error
            largest[k] = max(largest[k], abs(error))


@compiled
def add_middles(nodes: Pair, nodal: Array, middles: Pair, sums: Array, largest: Array) -> None:
    """As :func:`add_values` for all cells of a mesh and the middles of their edges, each evaluated once.

    ``nodal`` is u at the ``nodes``; ``middles`` is u in the middle of the edges along xi, of shape
    ``(n_xi - 1, n_eta)``, and of those along eta, of shape ``(n_xi, n_eta - 1)``.
    """
    (x, y), (of_xi, of_eta) = nodes, middles
    columns = x.shape[1] - 1
    for i in range(x.shape[0] - 1):
        for j in range(columns):
            k = i * columns + j
            ax, ay, bx = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j], x[i + 1, j + 1] - x[i + 1, j]
            by = y[i + 1, j + 1] - y[i + 1, j]
            cx, cy = x[i + 1, j + 1] - x[i, j + 1], y[i + 1, j + 1] - y[i, j + 1]
            dx, dy = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            ex, ey, fx, fy = 0.5 * (ax + cx), 0.5 * (ay + cy), 0.5 * (bx + dx), 0.5 * (by + dy)
            bottom = 0.5 * (nodal[i, j] + nodal[i + 1, j]) - of_xi[i, j]
            top = 0.5 * (nodal[i, j + 1] + nodal[i + 1, j + 1]) - of_xi[i, j + 1]
            left = 0.5 * (nodal[i, j] + nodal[i, j + 1]) - of_eta[i, j]
            right = 0.5 * (nodal[i + 1, j] + nodal[i + 1, j + 1]) - of_eta[i + 1, j]
            total = (ax * fy - ay * fx) * bottom * bottom + (cx * fy - cy * fx) * top * top
            total += (ex * dy - ey * dx) * left * left + (ex * by - ey * bx) * right * right
            sums[k] += MIDDLE_WEIGHT * total
            largest[k] = max(max(largest[k], max(abs(bottom), abs(top))), max(abs(left), abs(right)))
