"""The compiled loops of the objective: error, distortion and smoothness of a mesh with their derivatives.

A cell adds its share of a derivative to those of its nodes. Cells without a common node can be visited on several
threads; the cells of a node always add to it in the same order.

Each node has five sums: the derivatives by x and y, and the entries ``(xx, xy, yy)`` of a positive semidefinite
approximation of the second derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import (
    Basis,
    CellKind,
    Element,
    at_point,
    basis,
    determinant,
    gradient,
    quadrilateral,
    triangle,
)
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts

SUMS = 5
"""Sums of a node: derivatives by x and y, and the three second derivatives."""
CELLS_AT_ONCE = 16
"""Cells whose numbers are gathered in the rows of one array, in which the compiler can use vector instructions.

With all rows in one array it knows that none overlap. With several it asks at run time, and the order of sums would
depend on where these lie in the memory.
"""
NODE_ROWS = 5
"""Numbers of a corner that are gathered: x, y, u and its gradient."""
POINT_ROWS = 20
"""The first row of u and its gradient at the points, after those of the corners."""
SUM_ROWS = 23
"""The first row of the sums of the corners."""
SHAPE_ROWS = 16
"""The same for distortions: the first row of the sums of the corners, after x and y of the corners in two meshes."""


class Nodes(NamedTuple):
    """Positions of the nodes, and the node at every corner of the quadrilaterals: corner k of cell c is 4 c + k."""

    x: Array
    y: Array
    corners: IntArray


class NodalValues(NamedTuple):
    """u and its gradient at points of one shape."""

    u: Array
    u_x: Array
    u_y: Array


class Values(NamedTuple):
    """u with its derivatives to the second order at points of one shape."""

    u: Array
    u_x: Array
    u_y: Array
    u_xx: Array
    u_xy: Array
    u_yy: Array


@vectorised
def place_points(nodes: Nodes, elements: IntArray, shape: Array, begin: int, out_x: Array, out_y: Array) -> None:
    """The quadrature points of ``elements`` of three or four corners, in flat arrays from the place ``begin`` on.

    Point q of element c is the ``q count + c``-th.
    """
    x, y, corners = nodes
    count, last = elements.shape[0], elements.shape[1] - 1
    for c in range(count):
        i, j, k, m = (
            corners[elements[c, 0]],
            corners[elements[c, 1]],
            corners[elements[c, 2]],
            corners[elements[c, last]],
        )
        x0, x1, x2, x3, y0, y1, y2, y3 = x[i], x[j], x[k], x[m], y[i], y[j], y[k], y[m]
        for q in range(shape.shape[0]):
            n0, n1, n2, n3 = shape[q, 0], shape[q, 1], shape[q, 2], shape[q, last] if last == 3 else 0.0
            place = begin + q * count + c
            out_x[place] = n0 * x0 + n1 * x1 + n2 * x2 + n3 * x3
            out_y[place] = n0 * y0 + n1 * y1 + n2 * y2 + n3 * y3


@inlined
def gather(nodes: Nodes, nodal: NodalValues, element: IntArray, corner: Array) -> None:
    """x, y, u and its gradient at the corners of an element, in the rows of ``corner``, shape ``(5, corners)``."""
    for k in range(element.size):
        node = nodes.corners[element[k]]
        corner[0, k], corner[1, k] = nodes.x[node], nodes.y[node]
        corner[2, k], corner[3, k], corner[4, k] = nodal.u[node], nodal.u_x[node], nodal.u_y[node]


@inlined
def add_own(nodes: Nodes, element: IntArray, own: Array, sums: Array) -> None:
    """Add the sums of the corners of an element to those of its nodes."""
    for k in range(element.size):
        for entry in range(SUMS):
            sums[nodes.corners[element[k]], entry] += own[entry, k]


@vectorised
def value_errors(
    nodes: Nodes, elements: IntArray, element: Element, nodal: NodalValues, at: NodalValues, sums: Array
) -> tuple[float, float]:
    """The integral of the squared error of the interpolant; adds its derivatives to the ``sums`` of the nodes.

    u ``at`` the points has the shape ``(points, elements)``. The second result is finite if all values of u are.

    With e the error at a point, N the shape function of a corner and grad N its gradient, the derivative by the
    position of the corner is ``2 e N (grad u(corner) - grad u(point)) + e^2 grad N``, integrated over the cell.
    """
    shape, along_s, along_t, weights = element
    total, check, count = 0.0, 0.0, elements.shape[1]
    corner, own = np.empty((NODE_ROWS, count)), np.empty((SUMS, count))
    for c in range(elements.shape[0]):
        gather(nodes, nodal, elements[c], corner)
        for k in range(count):
            check += corner[2, k] + corner[3, k] + corner[4, k]
            for entry in range(SUMS):
                own[entry, k] = 0.0
        for q in range(weights.size):
            by, _, e = at_point(element, q, count, corner, 2, -at.u[q, c])
            check += at.u[q, c] + at.u_x[q, c] + at.u_y[q, c]
            area, square = weights[q] * determinant(by), weights[q] * e * e
            total += area * e * e
            for k in range(count):
                part, factor = shape[q, k], 2.0 * area * shape[q, k]
                d_x, d_y = corner[3, k] - at.u_x[q, c], corner[4, k] - at.u_y[q, c]
                n_x, n_y = gradient(along_s[q, k], along_t[q, k], by, square)
                own[0, k] += factor * e * d_x + n_x
                own[1, k] += factor * e * d_y + n_y
                own[2, k] += factor * part * d_x * d_x
                own[3, k] += factor * part * d_x * d_y
                own[4, k] += factor * part * d_y * d_y
        add_own(nodes, elements[c], own, sums)
    return total, check


@vectorised
def slope_errors(
    nodes: Nodes, elements: IntArray, element: Element, nodal: NodalValues, at: Values, sums: Array
) -> tuple[float, float]:
    """The integral of the squared error of the interpolant's gradient; adds its derivatives as :func:`value_errors`.

    With e the error of the gradient, H the second derivatives of u and v the gradient of the interpolant, the
    derivative by a corner is ``2 ((e . grad N) (grad u(corner) - v) - N H e) + |e|^2 grad N``, integrated.
    """
    shape, along_s, along_t, weights = element
    total, check, count = 0.0, 0.0, elements.shape[1]
    corner, own = np.empty((NODE_ROWS, count)), np.empty((SUMS, count))
    for c in range(elements.shape[0]):
        gather(nodes, nodal, elements[c], corner)
        for k in range(count):
            check += corner[2, k] + corner[3, k] + corner[4, k]
            for entry in range(SUMS):
                own[entry, k] = 0.0
        for q in range(weights.size):
            by, (v_s, v_t), _ = at_point(element, q, count, corner, 2, 0.0)
            det = determinant(by)
            per_det, area = 1.0 / det, weights[q] * det
            v_x, v_y = gradient(v_s, v_t, by, per_det)
            e_x, e_y = v_x - at.u_x[q, c], v_y - at.u_y[q, c]
            xx, xy, yy = at.u_xx[q, c], at.u_xy[q, c], at.u_yy[q, c]
            check += at.u[q, c] + at.u_x[q, c] + at.u_y[q, c] + xx + xy + yy
            bent_x, bent_y, square = xx * e_x + xy * e_y, xy * e_x + yy * e_y, e_x * e_x + e_y * e_y
            total += area * square
            for k in range(count):
                part = shape[q, k]
                n_x, n_y = gradient(along_s[q, k], along_t[q, k], by, per_det)
                d_x, d_y, along = corner[3, k] - v_x, corner[4, k] - v_y, e_x * n_x + e_y * n_y
                own[0, k] += area * (2.0 * (along * d_x - part * bent_x) + square * n_x)
                own[1, k] += area * (2.0 * (along * d_y - part * bent_y) + square * n_y)
                # The change of e with the position is the matrix grad N d^T - N H.
                a, b = n_x * d_x - part * xx, n_x * d_y - part * xy
                f, g = n_y * d_x - part * xy, n_y * d_y - part * yy
                own[2, k] += 2.0 * area * (a * a + f * f)
                own[3, k] += 2.0 * area * (a * b + f * g)
                own[4, k] += 2.0 * area * (b * b + g * g)
        add_own(nodes, elements[c], own, sums)
    return total, check


@vectorised
def quad_value_errors(
    nodes: Nodes, cells: tuple[int, int], element: Element, nodal: NodalValues, at: NodalValues, sums: Array
) -> tuple[float, float]:
    """As :func:`value_errors`, for a range of ``cells``, which are quadrilaterals: a few cells at once."""
    shape, along_s, along_t, weights = element
    total, check, m = 0.0, 0.0, CELLS_AT_ONCE
    corner = np.empty((SUM_ROWS + 4 * SUMS) * m)
    for first in range(cells[0], cells[1], m):
        size, before = min(m, cells[1] - first), first - cells[0]
        for j in range(size):
            for k in range(4):
                node = nodes.corners[4 * (first + j) + k]
                place = NODE_ROWS * k * m + j
                corner[place], corner[place + m] = nodes.x[node], nodes.y[node]
                corner[place + 2 * m], corner[place + 3 * m] = nodal.u[node], nodal.u_x[node]
                corner[place + 4 * m] = nodal.u_y[node]
        for j in range(SUM_ROWS * m, (SUM_ROWS + 4 * SUMS) * m):
            corner[j] = 0.0
        for q in range(weights.size):
            n0, n1, n2, n3 = shape[q, 0], shape[q, 1], shape[q, 2], shape[q, 3]
            s0, s2, t0, t2, weight = along_s[q, 0], along_s[q, 2], along_t[q, 0], along_t[q, 2], weights[q]
            for j in range(size):
                place = POINT_ROWS * m + j
                corner[place], corner[place + m] = at.u[q, before + j], at.u_x[q, before + j]
                corner[place + 2 * m] = at.u_y[q, before + j]
            for j in range(size):
                # Along s the derivatives of the first two shape functions are opposite, and those of the others.
                x_s = s2 * (corner[10 * m + j] - corner[15 * m + j]) - s0 * (corner[5 * m + j] - corner[j])
                y_s = s2 * (corner[11 * m + j] - corner[16 * m + j]) - s0 * (corner[6 * m + j] - corner[m + j])
                x_t = t2 * (corner[10 * m + j] - corner[5 * m + j]) - t0 * (corner[15 * m + j] - corner[j])
                y_t = t2 * (corner[11 * m + j] - corner[6 * m + j]) - t0 * (corner[16 * m + j] - corner[m + j])
                u, u_x, u_y = corner[20 * m + j], corner[21 * m + j], corner[22 * m + j]
                e = n0 * corner[2 * m + j] + n1 * corner[7 * m + j] + n2 * corner[12 * m + j] + n3 * corner[17 * m + j]
                e -= u
                check += u + u_x + u_y
                area, square = weight * (x_s * y_t - x_t * y_s), weight * e * e
                total += area * e * e
                one, other = s0 * y_t - t0 * y_s, t0 * x_s - s0 * x_t
                add_point(corner, j, 0, (n0, 2.0 * area * n0, e), (u_x, u_y), (square * one, square * other))
                one, other = t2 * y_s - s0 * y_t, s0 * x_t - t2 * x_s
                add_point(corner, j, 1, (n1, 2.0 * area * n1, e), (u_x, u_y), (square * one, square * other))
                one, other = s2 * y_t - t2 * y_s, t2 * x_s - s2 * x_t
                add_point(corner, j, 2, (n2, 2.0 * area * n2, e), (u_x, u_y), (square * one, square * other))
                one, other = t0 * y_s - s2 * y_t, s2 * x_t - t0 * x_s
                add_point(corner, j, 3, (n3, 2.0 * area * n3, e), (u_x, u_y), (square * one, square * other))
        for j in range(size):
            for k in range(4):
                node, place = nodes.corners[4 * (first + j) + k], NODE_ROWS * k * m + j
                check += corner[place + 2 * m] + corner[place + 3 * m] + corner[place + 4 * m]
                for entry in range(SUMS):
                    sums[node, entry] += corner[(SUM_ROWS + SUMS * k + entry) * m + j]
    return total, check


@inlined
def add_point(
    corner: Array,
    j: int,
    k: int,
    factors: tuple[float, float, float],
    slope: tuple[float, float],
    moved: tuple[float, float],
) -> None:
    """Add what a point has for corner k of the j-th cell, see :func:`value_errors`.

    ``factors`` are the shape function, that times twice the area, and the error.
    """
    m, base, own = CELLS_AT_ONCE, 5 * k * CELLS_AT_ONCE + j, (5 * k + SUM_ROWS) * CELLS_AT_ONCE + j
    part, factor, e = factors
    d_x, d_y = corner[base + 3 * m] - slope[0], corner[base + 4 * m] - slope[1]
    corner[own] += factor * e * d_x + moved[0]
    corner[own + m] += factor * e * d_y + moved[1]
    f_x, f_y = factor * part * d_x, factor * part * d_y
    corner[own + 2 * m] += f_x * d_x
    corner[own + 3 * m] += f_x * d_y
    corner[own + 4 * m] += f_y * d_y


@vectorised
def distortions(nodes: Nodes, start: Nodes, cells: tuple[int, int], weight: float, sums: Array) -> float:
    """The sum of ``(r^2 - 1) / 2`` over the corners of a range of ``cells``, of which none is folded.

    Adds ``weight`` times its derivatives to the ``sums`` of the nodes. A corner has the edges a and b, and those of the
    ``start`` a0 and b0. With ``A = [a b] [a0 b0]^-1`` it has ``r = |A|^2 / (2 det A)``: at least 1, which is a
    similarity, and unbounded towards a fold.
    """
    m, total = CELLS_AT_ONCE, 0.0
    corner = np.empty((SHAPE_ROWS + 4 * SUMS) * m)
    for first in range(cells[0], cells[1], m):
        size = min(m, cells[1] - first)
        for j in range(size):
            for k in range(4):
                node, place = nodes.corners[4 * (first + j) + k], 4 * k * m + j
                corner[place], corner[place + m] = nodes.x[node], nodes.y[node]
                corner[place + 2 * m], corner[place + 3 * m] = start.x[node], start.y[node]
        for j in range(SHAPE_ROWS * m, (SHAPE_ROWS + 4 * SUMS) * m):
            corner[j] = 0.0
        for j in range(size):
            total += distort(corner, j, (0, 1, 3), weight)
        for j in range(size):
            total += distort(corner, j, (1, 2, 0), weight)
        for j in range(size):
            total += distort(corner, j, (2, 3, 1), weight)
        for j in range(size):
            total += distort(corner, j, (3, 0, 2), weight)
        for j in range(size):
            for k in range(4):
                node = nodes.corners[4 * (first + j) + k]
                for entry in range(SUMS):
                    sums[node, entry] += corner[(SHAPE_ROWS + SUMS * k + entry) * m + j]
    return total


Direction: TypeAlias = tuple[float, float]


@inlined
def distort(corner: Array, j: int, numbers: tuple[int, int, int], weight: float) -> float:
    """``(r^2 - 1) / 2`` of a corner of the j-th cell; adds ``weight`` times its derivatives.

    ``numbers`` are those of the corner, of the next one, and of the one before.
    """
    m = CELLS_AT_ONCE
    here, ahead, behind = 4 * m * numbers[0] + j, 4 * m * numbers[1] + j, 4 * m * numbers[2] + j
    x, y, x0, y0 = corner[here], corner[here + m], corner[here + 2 * m], corner[here + 3 * m]
    ax, ay, bx, by = corner[ahead] - x, corner[ahead + m] - y, corner[behind] - x, corner[behind + m] - y
    cx, cy = corner[ahead + 2 * m] - x0, corner[ahead + 3 * m] - y0
    dx, dy = corner[behind + 2 * m] - x0, corner[behind + 3 * m] - y0
    det0, det = cx * dy - cy * dx, ax * by - ay * bx
    per_det0, per_det = 1.0 / det0, 1.0 / det
    k00, k01, k10, k11 = dy * per_det0, -dx * per_det0, -cy * per_det0, cx * per_det0
    a00, a01, a10, a11 = ax * k00 + bx * k10, ax * k01 + bx * k11, ay * k00 + by * k10, ay * k01 + by * k11
    inverse = det0 * per_det  # of det A
    r = 0.5 * (a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11) * inverse
    # The derivatives of the logarithm of det by a and by b, then those of r.
    na, ma, nb, mb = by * per_det, -bx * per_det, -ay * per_det, ax * per_det
    ga, ha = (a00 * k00 + a01 * k01) * inverse - r * na, (a10 * k00 + a11 * k01) * inverse - r * ma
    gb, hb = (a00 * k10 + a01 * k11) * inverse - r * nb, (a10 * k10 + a11 * k11) * inverse - r * mb
    add_corner(
        corner, (SHAPE_ROWS + 5 * numbers[1]) * m + j, weight, r, (ga, ha), (na, ma), (k00 * k00 + k01 * k01) * inverse
    )
    add_corner(
        corner, (SHAPE_ROWS + 5 * numbers[2]) * m + j, weight, r, (gb, hb), (nb, mb), (k10 * k10 + k11 * k11) * inverse
    )
    size = ((k00 + k10) * (k00 + k10) + (k01 + k11) * (k01 + k11)) * inverse
    add_corner(
        corner, (SHAPE_ROWS + 5 * numbers[0]) * m + j, weight, r, (-ga - gb, -ha - hb), (-na - nb, -ma - mb), size
    )
    return float(0.5 * (r * r - 1.0))


@inlined
def add_corner(
    corner: Array, at: int, weight: float, r: float, slope: Direction, stretch: Direction, size: float
) -> None:
    """Adds the derivatives of ``(r^2 - 1) / 2`` by one node, from those of r and of the logarithm of the Jacobian."""
    (g, h), (a, b), m = slope, stretch, CELLS_AT_ONCE
    corner[at] += weight * r * g
    corner[at + m] += weight * r * h
    corner[at + 2 * m] += weight * (r * size + 2.0 * r * r * a * a + g * g)
    corner[at + 3 * m] += weight * (2.0 * r * r * a * b + g * h)
    corner[at + 4 * m] += weight * (r * size + 2.0 * r * r * b * b + h * h)


@compiled
def oblique_corners(nodes: Nodes, cells: tuple[int, int], limit: float, weight: float, sums: Array) -> float:
    """The sum of ``max(|c| - limit, 0)^2 / 2`` over the corners of a range of ``cells``, c the cotangent of the angle.

    Adds ``weight`` times its derivatives to the ``sums`` of the nodes. Corners whose angles are within the limit add
    nothing. Infinite where a corner is folded.
    """
    x, y, corners = nodes
    total = 0.0
    for cell in range(cells[0], cells[1]):
        for k in range(4):
            p, n, m = corners[4 * cell + k], corners[4 * cell + (k + 1) % 4], corners[4 * cell + (k + 3) % 4]
            ax, ay, bx, by = x[n] - x[p], y[n] - y[p], x[m] - x[p], y[m] - y[p]
            det = ax * by - ay * bx
            if not det > 0.0:
                return np.inf
            cotangent = (ax * bx + ay * by) / det
            over = abs(cotangent) - limit
            if over <= 0.0:
                continue
            total += 0.5 * over * over
            sign = 1.0 if cotangent > 0.0 else -1.0
            per_det = sign / det
            ga, ha = (bx - cotangent * by) * per_det, (by + cotangent * bx) * per_det
            gb, hb = (ax + cotangent * ay) * per_det, (ay - cotangent * ax) * per_det
            add_slope(sums, n, weight, over, ga, ha)
            add_slope(sums, m, weight, over, gb, hb)
            add_slope(sums, p, weight, over, -ga - gb, -ha - hb)
    return total


@inlined
def add_slope(sums: Array, node: int, weight: float, over: float, g: float, h: float) -> None:
    """Adds the derivatives of half a square by one node, from the root ``over`` and its derivatives g and h."""
    sums[node, 0] += weight * over * g
    sums[node, 1] += weight * over * h
    sums[node, 2] += weight * g * g
    sums[node, 3] += weight * g * h
    sums[node, 4] += weight * h * h


@vectorised
def collect(sums: Array, factor: float, out: Array) -> None:
    """``factor`` times the ``sums``, in ``out`` of shape ``(5, nodes)``."""
    for node in range(sums.shape[0]):
        for entry in range(SUMS):
            out[entry, node] = factor * sums[node, entry]


@compiled
def smallest_share(nodes: Nodes, start: Nodes) -> float:
    """The smallest Jacobian of a corner over that of the ``start``; not positive where a cell is folded."""
    x, y, corners = nodes
    x0, y0, _ = start
    smallest, check = np.inf, 0.0  # min ignores NaN, a sum does not
    for cell in range(corners.size // 4):
        for k in range(4):
            p, n, m = corners[4 * cell + k], corners[4 * cell + (k + 1) % 4], corners[4 * cell + (k + 3) % 4]
            det0 = (x0[n] - x0[p]) * (y0[m] - y0[p]) - (y0[n] - y0[p]) * (x0[m] - x0[p])
            share = ((x[n] - x[p]) * (y[m] - y[p]) - (y[n] - y[p]) * (x[m] - x[p])) / det0
            smallest = min(smallest, share)
            check += share
    return smallest if np.isfinite(check) else -np.inf


@vectorised
def bends(moves: Array, triples: IntArray, out: Array) -> float:
    """Half the sum of squared second differences of ``moves`` over ``triples``; adds the derivatives to ``out``."""
    total = 0.0
    for k in range(triples.shape[0]):
        a, b, c = triples[k, 0], triples[k, 1], triples[k, 2]
        bend = moves[a] - 2.0 * moves[b] + moves[c]
        total += bend * bend
        out[a] += bend
        out[b] -= 2.0 * bend
        out[c] += bend
    return 0.5 * total


class Smoothness(NamedTuple):
    """What keeps a mesh smooth: triples of nodes, the weight of their bends, and the sum of squared weights of each
    node; and where nodes may move, see :class:`~equimesh.least_error.cells.Cells`."""

    triples: IntArray
    weight: float
    stiffness: Array
    free: Array


@vectorised
def finish(
    mesh: Array, start: Array, sums: Array, factor: float, smooth: Smoothness, gradient: Array, blocks: Array
) -> float:
    """The smoothness, and the derivatives by the nodes, where these are the unknowns and none are tied.

    ``factor`` times the ``sums`` are those of error and distortion. ``gradient`` has shape ``(2, nodes)``, ``blocks``
    ``(3, nodes)``.
    """
    triples, weight, stiffness, free = smooth
    moves = np.empty(mesh.shape)
    for axis in range(2):
        for node in range(mesh.shape[1]):
            moves[axis, node], gradient[axis, node] = mesh[axis, node] - start[axis, node], 0.0
    smoothness = bends(moves[0], triples, gradient[0]) + bends(moves[1], triples, gradient[1])
    for node in range(mesh.shape[1]):
        one, other = free[0, node], free[1, node]
        gradient[0, node] = (weight * gradient[0, node] + factor * sums[node, 0]) * one
        gradient[1, node] = (weight * gradient[1, node] + factor * sums[node, 1]) * other
        blocks[0, node] = factor * sums[node, 2] + weight * stiffness[node]
        blocks[1, node] = factor * sums[node, 3] * one * other
        blocks[2, node] = factor * sums[node, 4] + weight * stiffness[node]
    return smoothness


# Elements on which the error is measured: bilinear quadrilaterals, or the triangles of a cut mesh.

Norm: TypeAlias = Literal["l2", "h1"]


@dataclass(frozen=True, kw_only=True)
class Rule:
    """The norm of the error, the cells on which it is measured, and Gauss points a direction on quadrilaterals.

    ``degree`` is that of the interpolant.
    """

    norm: Norm = "l2"
    cells: CellKind = "quad"
    points: int = 3
    degree: int = 1

    @cached_property
    def element(self) -> Element:
        """The reference element with its quadrature."""
        return quadrilateral(self.points) if self.cells == "quad" else triangle(finer=self.degree > 1)

    @cached_property
    def basis(self) -> Basis:
        """The Lagrange basis of the interpolant at the points of quadrature."""
        return basis(self.cells, self.degree, self.element)

    @cached_property
    def inner_places(self) -> Array:
        """The shape functions of the corners at the other nodes of the interpolant, ``(nodes, corners)``."""
        return self.basis.places[self.basis.places.shape[1] :].copy()

    @property
    def points_per_cell(self) -> int:
        """Points of a quadrilateral at which u is evaluated: those of quadrature, and nodes beside the corners."""
        inner = len(self.inner_places) if self.degree > 1 else 0
        return (self.element.weights.size + inner) * (1 if self.cells == "quad" else 2)

    def elements(self, count: int, nodes: Nodes | None = None, through: Mapping[int, int] = ANYWHERE) -> IntArray:
        """The corners, ``4 cell + corner``, of the elements of ``count`` cells, shape ``(elements, 4 or 3)``.

        Triangles are those of the better cut of the cells with ``nodes``, or of the first. The cells in ``through``
        have the cut given there.
        """
        if self.cells == "quad":
            return np.arange(4 * count).reshape(count, 4)
        cuts = (
            np.zeros(count, dtype=np.int64)
            if nodes is None
            else better_cuts(np.stack([nodes.x, nodes.y], axis=-1)[nodes.corners].reshape(-1, 4, 2), through)
        )
        triangles: IntArray = CUTS[cuts] + 4 * np.arange(count)[:, None, None]
        return triangles.reshape(-1, 3)
