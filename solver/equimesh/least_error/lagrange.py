"""The compiled loops of the error of interpolants of degree 2 and more, whose nodes are placed by the map of a cell.

With x_j the nodes, phi_j the Lagrange basis and N_k the shape functions of the corners, the error at a point x_q is
``e(q) = sum_j phi_j(q) u(x_j) - u(x_q)``. A corner moves the nodes and the point with it, so that the derivative of e
by its position is ``d_k(q) = sum_j phi_j(q) N_k(j) grad u(x_j) - N_k(q) grad u(x_q)``. Degree 1 has loops of its own,
which are faster, in :mod:`equimesh.least_error.kernels`.
"""

from __future__ import annotations

import numpy as np

from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Values, add_own
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
