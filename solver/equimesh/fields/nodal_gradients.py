"""Gradients of u at the nodes of a mesh, from differences of the nodal values along its grid lines."""

from __future__ import annotations

import numpy as np

from equimesh.numerics.types import Array, Pair

MIN_SINE = 0.02
"""The smallest sine of the angle between the two grid lines of a node at which both lines give its gradient."""


def nodal_gradients(x: Array, y: Array, values: Array) -> Pair:
    """``(u_x, u_y)`` at the nodes of a mesh without folds; all arrays have the shape ``(n_xi, n_eta)``.

    By the chain rule from the derivatives of x, y and u along both grid lines of a node. These are those of the
    parabola through three neighbouring nodes over the length of the line, one-sided at a side. Linear functions are
    exact; for a smooth u on smooth meshes the error is O(h^2). Where both lines have nearly one direction, the mean
    of the gradients in the cells around the node is taken, weighted by their areas.
    """
    x_s, y_s, u_s = _along(x, y, values)
    x_t, y_t, u_t = (part.T for part in _along(x.T, y.T, values.T))
    det = x_s * y_t - x_t * y_s
    poor = det < MIN_SINE * np.hypot(x_s, y_s) * np.hypot(x_t, y_t)
    per_det = 1.0 / np.where(poor, 1.0, det)
    u_x, u_y = (u_s * y_t - u_t * y_s) * per_det, (u_t * x_s - u_s * x_t) * per_det
    if poor.any():
        mean_x, mean_y = _cell_means(x, y, values)
        u_x, u_y = np.where(poor, mean_x, u_x), np.where(poor, mean_y, u_y)
    return u_x, u_y


def _along(x: Array, y: Array, values: Array) -> tuple[Array, Array, Array]:
    """The derivatives of x, y and u along the lines of the first index, by the length of the line."""
    steps = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0))
    before, after = steps[:-1], steps[1:]
    share = before / (before + after)

    def derivative(nodal: Array) -> Array:
        slopes = np.diff(nodal, axis=0) / steps
        out = np.empty_like(nodal)
        out[1:-1] = (1.0 - share) * slopes[:-1] + share * slopes[1:]
        out[0] = slopes[0] + (slopes[0] - out[1])
        out[-1] = slopes[-1] + (slopes[-1] - out[-2])
        return out

    return derivative(x), derivative(y), derivative(values)


def _cell_means(x: Array, y: Array, values: Array) -> Pair:
    """The gradients in the centres of the cells around each node, in the mean by area."""

    def diagonals(nodal: Array) -> Pair:
        return nodal[1:, 1:] - nodal[:-1, :-1], nodal[:-1, 1:] - nodal[1:, :-1]

    (x_a, x_b), (y_a, y_b), (u_a, u_b) = diagonals(x), diagonals(y), diagonals(values)
    # By Green's formula the integral of the gradient; the area is half of det.
    det = x_a * y_b - x_b * y_a
    parts = [_sum_at_nodes(part) for part in (u_a * y_b - u_b * y_a, u_b * x_a - u_a * x_b, det)]
    return parts[0] / parts[2], parts[1] / parts[2]


def _sum_at_nodes(cells: Array) -> Array:
    """The sum over the cells around each node."""
    out = np.zeros((cells.shape[0] + 1, cells.shape[1] + 1))
    for di in (0, 1):
        for dj in (0, 1):
            out[di : di + cells.shape[0], dj : dj + cells.shape[1]] += cells
    return out
