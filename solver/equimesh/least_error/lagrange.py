"""The compiled loops of the error of interpolants of degree 2 and more, whose nodes are placed by the map of a cell.

With x_j the nodes, phi_j the Lagrange basis and N_k the shape functions of the corners, the error at a point x_q is
``e(q) = sum_j phi_j(q) u(x_j) - u(x_q)``. A corner moves the nodes and the point with it, so that the derivative of e
by its position is ``d_k(q) = sum_j phi_j(q) N_k(j) grad u(x_j) - N_k(q) grad u(x_q)``. Degree 1 has loops of its own,
which are faster, in :mod:`equimesh.least_error.kernels`.
"""

from __future__ import annotations

import numpy as np

from equimesh.least_error.kernels import CELLS_AT_ONCE, SUMS, NodalValues, Nodes, Values, add_own
from equimesh.numerics.compiled import inlined, vectorised
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import Basis, Element, at_point, determinant, gradient


@inlined
def gather_element(
    nodes: Nodes, nodal: NodalValues, inside: NodalValues, element: IntArray, c: int, corner: Array, values: Array
) -> None:
    """x and y of the corners in the rows of ``corner``; u and its gradient at all nodes of element c in ``values``."""
    count = element.size
    for k in range(count):
        node = nodes.corners[element[k]]
        corner[0, k], corner[1, k] = nodes.x[node], nodes.y[node]
        values[0, k], values[1, k], values[2, k] = nodal.u[node], nodal.u_x[node], nodal.u_y[node]
    for j in range(inside.u.shape[0]):
        values[0, count + j] = inside.u[j, c]
        values[1, count + j] = inside.u_x[j, c]
        values[2, count + j] = inside.u_y[j, c]


@inlined
def total_of(values: Array) -> float:
    """The sum of all values: not finite where one of them is not."""
    total = 0.0
    for row in range(values.shape[0]):
        for j in range(values.shape[1]):
            total += values[row, j]
    return total


@inlined
def interpolate(row: Array, functions: Array, out: Array) -> None:
    """The values at all points of the interpolant of nodal values; ``functions`` are ``(nodes, points)``."""
    out[:] = 0.0
    for j in range(row.size):
        part = row[j]
        for q in range(out.size):
            out[q] += part * functions[j, q]


@inlined
def interpolate_moves(slopes: Array, places: Array, k: int, functions: Array, out: Array) -> None:
    """The derivatives of the interpolant at all points by the position of corner k, in two rows of ``out``.

    ``slopes`` are the gradients of u at the nodes, of shape ``(2, nodes)``.
    """
    out[:] = 0.0
    for j in range(places.shape[0]):
        part = places[j, k]
        if part != 0.0:
            x, y = part * slopes[0, j], part * slopes[1, j]
            for q in range(out.shape[1]):
                out[0, q] += x * functions[j, q]
                out[1, q] += y * functions[j, q]


@vectorised
def value_errors(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    basis: Basis,
    nodal: NodalValues,
    inside: NodalValues,
    at: NodalValues,
    sums: Array,
) -> tuple[float, float]:
    """The integral of the squared error; adds its derivatives to the ``sums`` of the nodes, as that of degree 1.

    ``nodal`` is u at the nodes of the mesh, ``inside`` at the other nodes of every element, of shape
    ``(nodes, elements)``, and ``at`` at the points of the rule, ``(points, elements)``. The second result is finite if
    all values of u are.
    """
    shape, along_s, along_t, weights = element
    points, count = weights.size, elements.shape[1]
    corner, values, own = np.empty((2, count)), np.empty((3, basis.places.shape[0])), np.empty((SUMS, count))
    error, moved, total, check = np.empty(points), np.empty((count, 2, points)), 0.0, 0.0
    for c in range(elements.shape[0]):
        gather_element(nodes, nodal, inside, elements[c], c, corner, values)
        check += total_of(values)
        interpolate(values[0], basis.value, error)
        for k in range(count):
            interpolate_moves(values[1:], basis.places, k, basis.value, moved[k])
        own[:] = 0.0
        for q in range(points):
            by, _, _ = at_point(element, q, count, corner, 0, 0.0)
            e = error[q] - at.u[q, c]
            check += at.u[q, c] + at.u_x[q, c] + at.u_y[q, c]
            area, square = weights[q] * determinant(by), weights[q] * e * e
            total += area * e * e
            for k in range(count):
                part, factor = shape[q, k], 2.0 * area
                d_x, d_y = moved[k, 0, q] - part * at.u_x[q, c], moved[k, 1, q] - part * at.u_y[q, c]
                n_x, n_y = gradient(along_s[q, k], along_t[q, k], by, square)
                own[0, k] += factor * e * d_x + n_x
                own[1, k] += factor * e * d_y + n_y
                own[2, k] += factor * d_x * d_x
                own[3, k] += factor * d_x * d_y
                own[4, k] += factor * d_y * d_y
        add_own(nodes, elements[c], own, sums)
    return total, check


@vectorised
def slope_errors(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    basis: Basis,
    nodal: NodalValues,
    inside: NodalValues,
    at: Values,
    sums: Array,
) -> tuple[float, float]:
    """The integral of the squared error of the gradient; adds its derivatives, as :func:`value_errors`.

    With v the gradient of the interpolant and H the second derivatives of u, the change of the error of the gradient
    with the position of corner k is the matrix ``sum_j grad phi_j N_k(j) grad u(x_j)^T - grad N_k v^T - N_k H``.
    """
    shape, along_s, along_t, weights = element
    points, count = weights.size, elements.shape[1]
    corner, values, own = np.empty((2, count)), np.empty((3, basis.places.shape[0])), np.empty((SUMS, count))
    total, check, slopes = 0.0, 0.0, np.empty((2, points))
    moved_s, moved_t = np.empty((count, 2, points)), np.empty((count, 2, points))
    for c in range(elements.shape[0]):
        gather_element(nodes, nodal, inside, elements[c], c, corner, values)
        check += total_of(values)
        interpolate(values[0], basis.along_s, slopes[0])
        interpolate(values[0], basis.along_t, slopes[1])
        for k in range(count):
            interpolate_moves(values[1:], basis.places, k, basis.along_s, moved_s[k])
            interpolate_moves(values[1:], basis.places, k, basis.along_t, moved_t[k])
        own[:] = 0.0
        for q in range(points):
            by, _, _ = at_point(element, q, count, corner, 0, 0.0)
            det, v_s, v_t = determinant(by), slopes[0, q], slopes[1, q]
            per_det, area = 1.0 / det, weights[q] * det
            v_x, v_y = gradient(v_s, v_t, by, per_det)
            e_x, e_y = v_x - at.u_x[q, c], v_y - at.u_y[q, c]
            xx, xy, yy = at.u_xx[q, c], at.u_xy[q, c], at.u_yy[q, c]
            check += at.u[q, c] + at.u_x[q, c] + at.u_y[q, c] + xx + xy + yy
            square = e_x * e_x + e_y * e_y
            total += area * square
            for k in range(count):
                part = shape[q, k]
                n_x, n_y = gradient(along_s[q, k], along_t[q, k], by, per_det)
                m_x, p_x = gradient(moved_s[k, 0, q], moved_t[k, 0, q], by, per_det)
                m_y, p_y = gradient(moved_s[k, 1, q], moved_t[k, 1, q], by, per_det)
                a, b = m_x - n_x * v_x - part * xx, m_y - n_x * v_y - part * xy
                f, g = p_x - n_y * v_x - part * xy, p_y - n_y * v_y - part * yy
                own[0, k] += area * (2.0 * (e_x * a + e_y * f) + square * n_x)
                own[1, k] += area * (2.0 * (e_x * b + e_y * g) + square * n_y)
                own[2, k] += 2.0 * area * (a * a + f * f)
                own[3, k] += 2.0 * area * (a * b + f * g)
                own[4, k] += 2.0 * area * (b * b + g * g)
        add_own(nodes, elements[c], own, sums)
    return total, check


# Biquadratic cells have a loop of their own: a few cells at once, as those of degree 1.

BIQUADRATIC_NODES = 9
"""The corners, the middles of the edges 3-0 and 0-1, the centre, and the middles of the edges 2-3 and 1-2."""
NODE_ROW = 8
"""The first row of u at the nodes, after x and y of the corners; its derivatives by x and y follow."""
POINT_ROW = NODE_ROW + 3 * BIQUADRATIC_NODES
"""The first row of u and its gradient at the points."""
SUM_ROW = POINT_ROW + 3
"""The first row of the sums of the corners."""


@vectorised
def biquadratic_value_errors(
    nodes: Nodes,
    cells: tuple[int, int],
    element: Element,
    functions: Array,
    nodal: NodalValues,
    inside: NodalValues,
    at: NodalValues,
    sums: Array,
) -> tuple[float, float]:
    """As :func:`value_errors`, for a range of ``cells`` and degree 2; ``functions`` are the basis at the points."""
    shape, along_s, along_t, weights = element
    total, check, m = 0.0, 0.0, CELLS_AT_ONCE
    corner = np.empty((SUM_ROW + 4 * SUMS) * m)
    for first in range(cells[0], cells[1], m):
        size, before = min(m, cells[1] - first), first - cells[0]
        for j in range(size):
            for k in range(BIQUADRATIC_NODES):
                place = (NODE_ROW + k) * m + j
                if k < 4:
                    node = nodes.corners[4 * (first + j) + k]
                    corner[k * m + j], corner[(4 + k) * m + j] = nodes.x[node], nodes.y[node]
                    u, u_x, u_y = nodal.u[node], nodal.u_x[node], nodal.u_y[node]
                else:
                    c = before + j
                    u, u_x, u_y = inside.u[k - 4, c], inside.u_x[k - 4, c], inside.u_y[k - 4, c]
                check += u + u_x + u_y
                corner[place], corner[place + BIQUADRATIC_NODES * m] = u, u_x
                corner[place + 2 * BIQUADRATIC_NODES * m] = u_y
        for j in range(SUM_ROW * m, (SUM_ROW + 4 * SUMS) * m):
            corner[j] = 0.0
        for q in range(weights.size):
            n0, n1, n2, n3 = shape[q, 0], shape[q, 1], shape[q, 2], shape[q, 3]
            s0, s2, t0, t2, weight = along_s[q, 0], along_s[q, 2], along_t[q, 0], along_t[q, 2], weights[q]
            f0, f1, f2, f3 = functions[0, q], functions[1, q], functions[2, q], functions[3, q]
            f4, f5, f6, f7, f8 = functions[4, q], functions[5, q], functions[6, q], functions[7, q], functions[8, q]
            for j in range(size):
                place = POINT_ROW * m + j
                corner[place], corner[place + m] = at.u[q, before + j], at.u_x[q, before + j]
                corner[place + 2 * m] = at.u_y[q, before + j]
            for j in range(size):
                # Along s the derivatives of the first two shape functions are opposite, and those of the others.
                x_s = s2 * (corner[2 * m + j] - corner[3 * m + j]) - s0 * (corner[m + j] - corner[j])
                y_s = s2 * (corner[6 * m + j] - corner[7 * m + j]) - s0 * (corner[5 * m + j] - corner[4 * m + j])
                x_t = t2 * (corner[2 * m + j] - corner[m + j]) - t0 * (corner[3 * m + j] - corner[j])
                y_t = t2 * (corner[6 * m + j] - corner[5 * m + j]) - t0 * (corner[7 * m + j] - corner[4 * m + j])
                place = POINT_ROW * m + j
                u, u_x, u_y = corner[place], corner[place + m], corner[place + 2 * m]
                place = NODE_ROW * m + j
                e = f0 * corner[place] + f1 * corner[place + m]
                e = e + f2 * corner[place + 2 * m] + f3 * corner[place + 3 * m]
                e += f4 * corner[place + 4 * m] + f5 * corner[place + 5 * m] + f6 * corner[place + 6 * m]
                e += f7 * corner[place + 7 * m] + f8 * corner[place + 8 * m] - u
                check += u + u_x + u_y
                area, square = weight * (x_s * y_t - x_t * y_s), weight * e * e
                total += area * e * e
                known = 2.0 * area, e, u_x, u_y
                one, other = square * (s0 * y_t - t0 * y_s), square * (t0 * x_s - s0 * x_t)
                add_moved(corner, j, (0, 4, 5), (f0, 0.5 * f4, 0.5 * f5, 0.25 * f6, n0), known, (one, other))
                one, other = square * (t2 * y_s - s0 * y_t), square * (s0 * x_t - t2 * x_s)
                add_moved(corner, j, (1, 5, 8), (f1, 0.5 * f5, 0.5 * f8, 0.25 * f6, n1), known, (one, other))
                one, other = square * (s2 * y_t - t2 * y_s), square * (t2 * x_s - s2 * x_t)
                add_moved(corner, j, (2, 8, 7), (f2, 0.5 * f8, 0.5 * f7, 0.25 * f6, n2), known, (one, other))
                one, other = square * (t0 * y_s - s2 * y_t), square * (s2 * x_t - t0 * x_s)
                add_moved(corner, j, (3, 7, 4), (f3, 0.5 * f7, 0.5 * f4, 0.25 * f6, n3), known, (one, other))
        for j in range(size):
            for k in range(4):
                node = nodes.corners[4 * (first + j) + k]
                for entry in range(SUMS):
                    sums[node, entry] += corner[(SUM_ROW + SUMS * k + entry) * m + j]
    return total, check


@inlined
def add_moved(
    corner: Array,
    j: int,
    numbers: tuple[int, int, int],
    parts: tuple[float, float, float, float, float],
    known: tuple[float, float, float, float],
    moved: tuple[float, float],
) -> None:
    """Add what a point has for a corner of the j-th cell, see :func:`value_errors`.

    ``numbers`` are those of the corner and of the middles of its edges, ``parts`` what these, the centre and the point
    move by. ``known`` are twice the area, the error, and the gradient of u.
    """
    m = CELLS_AT_ONCE
    by_x, by_y = (NODE_ROW + BIQUADRATIC_NODES) * m + j, (NODE_ROW + 2 * BIQUADRATIC_NODES) * m + j
    own, two, three = numbers[0] * m, numbers[1] * m, numbers[2] * m
    factor, e, u_x, u_y = known
    p, a, b, c, n = parts
    d_x = (
        p * corner[by_x + own] + a * corner[by_x + two] + b * corner[by_x + three] + c * corner[by_x + 6 * m] - n * u_x
    )
    d_y = (
        p * corner[by_y + own] + a * corner[by_y + two] + b * corner[by_y + three] + c * corner[by_y + 6 * m] - n * u_y
    )
    to = (SUM_ROW + SUMS * numbers[0]) * m + j
    f_x, f_y = factor * d_x, factor * d_y
    corner[to] += e * f_x + moved[0]
    corner[to + m] += e * f_y + moved[1]
    corner[to + 2 * m] += f_x * d_x
    corner[to + 3 * m] += f_x * d_y
    corner[to + 4 * m] += f_y * d_y
