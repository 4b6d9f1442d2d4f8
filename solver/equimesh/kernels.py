"""Compiled loops of the chord iteration: squared metric lengths, corrections and the fold check of a whole mesh.

All arrays are C-contiguous, of shape ``(n_xi, n_eta)`` unless said otherwise. Coordinate differences are not divided
by the spacing: a flux here is the squared metric length of an edge. The kernels hold no interpreter lock, are compiled
once per machine, and call no user code.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt
from numba import njit

Array: TypeAlias = npt.NDArray[np.float64]
P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """The function as machine code, kept on disk where there is a folder to keep it in."""
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # numba finds no folder that it may write to
        return njit(nogil=True, error_model="numpy")(function)


@compiled
def squared_lengths(x: Array, y: Array, u: Array, a2: float, b: float, along_xi: Array, along_eta: Array) -> None:
    """Squared metric lengths of all edges that meet an interior node.

    ``along_xi[i, j]`` is that of the edge from node (i, j) to (i + 1, j), ``along_eta[i, j]`` from (i, j) to
    (i, j + 1); edges on the sides hold half of it.
    """
    n_xi, n_eta = x.shape
    for j in range(n_eta - 1):
        along_eta[0, j] = 0.0
    for i in range(n_xi - 1):
        along_xi[i, 0] = 0.0
        for j in range(n_eta - 1):
            ex0, ey0 = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
            ex1, ey1 = x[i + 1, j + 1] - x[i, j + 1], y[i + 1, j + 1] - y[i, j + 1]
            fx0, fy0 = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            fx1, fy1 = x[i + 1, j + 1] - x[i + 1, j], y[i + 1, j + 1] - y[i + 1, j]
            ex, ey, fx, fy = 0.5 * (ex0 + ex1), 0.5 * (ey0 + ey1), 0.5 * (fx0 + fx1), 0.5 * (fy0 + fy1)
            diagonal, other = u[i + 1, j + 1] - u[i, j], u[i + 1, j] - u[i, j + 1]
            eu, fu = 0.5 * (diagonal + other), 0.5 * (diagonal - other)
            inverse = 1.0 / (ex * fy - fx * ey)
            gx, gy = (eu * fy - fu * ey) * inverse, (fu * ex - eu * fx) * inverse
            k = a2 / (1.0 + b * (gx * gx + gy * gy))
            g0, g1 = gx * ex0 + gy * ey0, gx * ex1 + gy * ey1
            h0, h1 = gx * fx0 + gy * fy0, gx * fx1 + gy * fy1
            along_xi[i, j] += 0.5 * (ex0 * ex0 + ey0 * ey0 + k * g0 * g0)
            along_xi[i, j + 1] = 0.5 * (ex1 * ex1 + ey1 * ey1 + k * g1 * g1)
            along_eta[i, j] += 0.5 * (fx0 * fx0 + fy0 * fy0 + k * h0 * h0)
            along_eta[i + 1, j] = 0.5 * (fx1 * fx1 + fy1 * fy1 + k * h1 * h1)


@compiled
def inverse_matrices(x: Array, y: Array, u: Array, a2: float, b: float, inverse: Array) -> None:
    """Inverse of the matrix ``[[A, B], [C, D]]`` at every interior node, in ``inverse`` of shape ``(4, n_xi, n_eta)``.

    ``(A, B) = M r_xi`` and ``(C, D) = M r_eta`` with centred differences; its determinant is ``det(M) J``.
    """
    n_xi, n_eta = x.shape
    for i in range(1, n_xi - 1):
        for j in range(1, n_eta - 1):
            ex, ey = 0.5 * (x[i + 1, j] - x[i - 1, j]), 0.5 * (y[i + 1, j] - y[i - 1, j])
            fx, fy = 0.5 * (x[i, j + 1] - x[i, j - 1]), 0.5 * (y[i, j + 1] - y[i, j - 1])
            eu, fu = 0.5 * (u[i + 1, j] - u[i - 1, j]), 0.5 * (u[i, j + 1] - u[i, j - 1])
            jacobian = ex * fy - fx * ey
            gx, gy = (eu * fy - fu * ey) / jacobian, (fu * ex - eu * fx) / jacobian
            square = gx * gx + gy * gy
            k = a2 / (1.0 + b * square)
            ge, gf = k * (gx * ex + gy * ey), k * (gx * fx + gy * fy)
            scale = 1.0 / (jacobian * (1.0 + k * square))
            inverse[0, i, j] = (fy + gf * gy) * scale
            inverse[1, i, j] = -(ey + ge * gy) * scale
            inverse[2, i, j] = -(fx + gf * gx) * scale
            inverse[3, i, j] = (ex + ge * gx) * scale


@compiled
def move_nodes(
    x: Array, y: Array, along_xi: Array, along_eta: Array, inverse: Array, new_x: Array, new_y: Array
) -> float:
    """Interior nodes moved by one sweep, into ``new_x`` and ``new_y``.

    Returns the largest relative deviation of a squared metric length from the mean of its line, before the sweep; NaN
    where something is not a number.
    """
    n_xi, n_eta = x.shape
    mean = np.zeros(n_eta)
    for i in range(n_xi - 1):
        for j in range(n_eta):
            mean[j] += along_xi[i, j]
    mean /= n_xi - 1
    running = np.zeros(n_eta)
    deviation, check = 0.0, 0.0  # min and max pass over what is not a number, a sum does not
    for j in range(1, n_eta - 1):
        running[j] = along_xi[0, j] - mean[j]
        deviation = max(deviation, abs(running[j]) / mean[j])
    for i in range(1, n_xi - 1):
        total = 0.0
        for j in range(n_eta - 1):
            total += along_eta[i, j]
        level = total / (n_eta - 1)
        q = along_eta[i, 0] - level
        deviation = max(deviation, abs(q) / level)
        for j in range(1, n_eta - 1):
            p = -0.5 * running[j]
            half = -0.5 * q
            dx = inverse[0, i, j] * p + inverse[1, i, j] * half
            dy = inverse[2, i, j] * p + inverse[3, i, j] * half
            new_x[i, j] = x[i, j] + dx
            new_y[i, j] = y[i, j] + dy
            check += dx + dy
            difference = along_xi[i, j] - mean[j]
            running[j] += difference
            deviation = max(deviation, abs(difference) / mean[j])
            change = along_eta[i, j] - level
            q += change
            deviation = max(deviation, abs(change) / level)
    return deviation if np.isfinite(check) else np.nan


@compiled
def smallest_jacobian(x: Array, y: Array) -> float:
    """The smallest corner Jacobian of a mesh, not scaled by the spacing; NaN where a coordinate is not a number."""
    n_xi, n_eta = x.shape
    smallest, check = np.inf, 0.0  # min and max pass over what is not a number, a sum does not
    for i in range(n_xi - 1):
        for j in range(n_eta - 1):
            ex0, ey0 = x[i + 1, j] - x[i, j], y[i + 1, j] - y[i, j]
            ex1, ey1 = x[i + 1, j + 1] - x[i, j + 1], y[i + 1, j + 1] - y[i, j + 1]
            fx0, fy0 = x[i, j + 1] - x[i, j], y[i, j + 1] - y[i, j]
            fx1, fy1 = x[i + 1, j + 1] - x[i + 1, j], y[i + 1, j + 1] - y[i + 1, j]
            one, two = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
            three, four = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
            smallest = min(smallest, one, two, three, four)
            check += one + two + three + four
    return smallest if np.isfinite(check) else np.nan
