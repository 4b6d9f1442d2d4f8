"""Compiled loops: the defects of the equations at all interior nodes, and what changes them."""

import numpy as np

from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array


@vectorised
def defects(x: Array, y: Array, m: Array, per_spacing: tuple[float, float], cross_line: float, out: Array) -> None:
    """The defects of both equations at the interior nodes, in ``out`` of shape ``(2, n_xi - 2, n_eta - 2)``.

    They are the values of :class:`~equimesh.equations.mesh_equations.MeshEquations` there: differences of the squared
    metric lengths of the two edges that meet at a node, and the cross-line term. ``m`` of shape ``(3, n_xi - 1,
    n_eta - 1)`` is the metric of the cells, ``per_spacing`` one over the squared spacings.
    """
    n_xi, n_eta = x.shape
    per_xi, per_eta = per_spacing
    before = np.empty(n_eta)
    for j in range(1, n_eta - 1):
        gx, gy = x[1, j] - x[0, j], y[1, j] - y[0, j]
        p11, p12, p22 = m[0, 0, j - 1] + m[0, 0, j], m[1, 0, j - 1] + m[1, 0, j], m[2, 0, j - 1] + m[2, 0, j]
        before[j] = 0.5 * (p11 * gx * gx + 2.0 * p12 * gx * gy + p22 * gy * gy)
    along = np.empty(n_eta)
    for i in range(1, n_xi - 1):
        for j in range(n_eta - 1):
            fx, fy = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            p11, p12, p22 = m[0, i - 1, j] + m[0, i, j], m[1, i - 1, j] + m[1, i, j], m[2, i - 1, j] + m[2, i, j]
            along[j] = 0.5 * (p11 * fx * fx + 2.0 * p12 * fx * fy + p22 * fy * fy)
        for j in range(1, n_eta - 1):
            gx, gy = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
            p11, p12, p22 = m[0, i, j - 1] + m[0, i, j], m[1, i, j - 1] + m[1, i, j], m[2, i, j - 1] + m[2, i, j]
            after = 0.5 * (p11 * gx * gx + 2.0 * p12 * gx * gy + p22 * gy * gy)
            bend_x = x[i, j - 1] - 2.0 * x[i, j] + x[i, j + 1]
            bend_y = y[i - 1, j] - 2.0 * y[i, j] + y[i + 1, j]
            out[0, i - 1, j - 1] = (after - before[j]) * per_xi + cross_line * per_eta * bend_x
            out[1, i - 1, j - 1] = (along[j] - along[j - 1]) * per_eta + cross_line * per_xi * bend_y
            before[j] = after


@compiled
def directions(x: Array, y: Array, m: Array, out: Array) -> None:
    """``A, B, C, D`` of the line corrections at the interior nodes, in ``out`` of shape ``(4, n_xi - 2, n_eta - 2)``.

    ``(A, B) = M r_xi`` and ``(C, D) = M r_eta``, with undivided central differences.
    """
    for i in range(1, x.shape[0] - 1):
        for j in range(1, x.shape[1] - 1):
            p11 = 0.25 * (m[0, i - 1, j - 1] + m[0, i - 1, j] + m[0, i, j - 1] + m[0, i, j])
            p12 = 0.25 * (m[1, i - 1, j - 1] + m[1, i - 1, j] + m[1, i, j - 1] + m[1, i, j])
            p22 = 0.25 * (m[2, i - 1, j - 1] + m[2, i - 1, j] + m[2, i, j - 1] + m[2, i, j])
            ex, ey = 0.5 * (x[i + 1, j] - x[i - 1, j]), 0.5 * (y[i + 1, j] - y[i - 1, j])
            fx, fy = 0.5 * (x[i, j + 1] - x[i, j - 1]), 0.5 * (y[i, j + 1] - y[i, j - 1])
            out[0, i - 1, j - 1] = p11 * ex + p12 * ey
            out[1, i - 1, j - 1] = p12 * ex + p22 * ey
            out[2, i - 1, j - 1] = p11 * fx + p12 * fy
            out[3, i - 1, j - 1] = p12 * fx + p22 * fy
