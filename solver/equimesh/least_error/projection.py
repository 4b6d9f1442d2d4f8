"""The objective of a mesh for a solver: the error of the Ritz projection of u in place of that of the interpolant.

The solution ``u_h = I u + w`` of linear or bilinear elements for Poisson's equation satisfies
``a(w, v) = a(u - I u, v)`` for all v that vanish on the boundary, with ``a(u, v)`` the integral of ``grad u . grad v``.
The derivative of the integral of ``(u_h - u)^2`` by the nodes needs one more solution with the same matrix. With z the
solution of ``a(v, z) = 2 (u_h - u, v)`` it is the derivative of ``|u_h - u|^2 - a(u_h - u, z)`` while w and z are held
at the nodes.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy

from equimesh.least_error import kernels
from equimesh.least_error.cells import Cells
from equimesh.least_error.kernels import NODE_ROWS, SUMS, NodalValues, Nodes, Values, add_own, gather
from equimesh.least_error.objective import Objective
from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import Element, at_point, determinant, gradient
from equimesh.quality.ritz import add_system, unknowns

MAX_CACHED = 16
"""Meshes whose unknowns are kept: the levels of one or two solves."""
MAX_WORK = 4.5e7
"""Unknowns times the square of the width of their band, at most: a grid of 81 x 81 points has as much."""
MAX_CELLS = 12_000
"""Cells, at most, of a mesh whose unknowns are put in order."""


class Unknowns(NamedTuple):
    """The values that a solver finds: at the nodes inside, those that are tied being one."""

    number: IntArray
    """The number of the unknown at each node, -1 on the boundary, shape ``(nodes,)``."""
    size: int
    """How many there are."""
    width: int
    """The largest difference of the numbers of two unknowns of one cell."""


@lru_cache(maxsize=MAX_CACHED)
def unknowns_of(cells: Cells) -> Unknowns:
    """The unknowns of a mesh, in an order in which neighbours have near numbers."""
    number = unknowns(cells.corners, cells.nodes, cells.ties)
    size = int(number.max(initial=-1)) + 1
    if not size:
        return Unknowns(number, 0, 0)
    widths = [_width(number[cells.corners])]
    at = number[cells.corners]
    one, two = (corner.ravel() for corner in np.broadcast_arrays(at[:, :, None], at[:, None]))
    known = (one >= 0) & (two >= 0)
    graph = scipy.sparse.csr_matrix((np.ones(known.sum()), (one[known], two[known])), shape=(size, size))
    order = np.empty(size + 1, dtype=np.int64)
    order[scipy.sparse.csgraph.reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(size)
    order[-1] = -1
    other = order[number]
    widths.append(_width(other[cells.corners]))
    best = number if widths[0] <= widths[1] else other
    return Unknowns(np.ascontiguousarray(best), size, min(widths))


def _width(numbers: IntArray) -> int:
    """The largest difference of two unknowns of a cell."""
    lowest = np.where(numbers < 0, np.iinfo(np.int64).max, numbers).min(axis=1)
    widest = np.where((numbers < 0).all(axis=1), 0, numbers.max(axis=1) - lowest)
    return int(widest.max())


def is_projected(cells: Cells) -> bool:
    """Whether a solver's error on a mesh is known in a moderate time."""
    if cells.count > MAX_CELLS:
        return False
    _, count, width = unknowns_of(cells)
    return 0 < count * width * width <= MAX_WORK


class ProjectedObjective(Objective):
    """The objective with the error of the Ritz projection of u, for degree 1 and the norm of u."""

    def _squared_error(self, nodes: Nodes) -> float:
        """The square of the error, with its sums of the nodes in place of all others; negative without a projection."""
        element, elements = self._rule.element, self._elements
        shape, split = (element.weights.size, len(elements)), nodes.x.size
        x, y = np.empty((2, split + shape[0] * shape[1]))
        x[:split], y[:split] = nodes.x, nodes.y
        kernels.place_points(nodes, elements, element.shape, split, x, y)
        values = self._u.evaluate(x, y, order=2)
        nodal = NodalValues(*(part[:split].copy() for part in values[:3]))
        if not self._has_slopes(nodes, nodal):
            return math.inf
        if not math.isfinite(sum(float(part[split:].sum()) for part in values)):
            return math.inf
        at = Values(*(part[split:].reshape(shape) for part in values))
        self._sums.fill(0.0)
        unknowns = unknowns_of(self.cells)
        square = projected_errors(
            nodes, elements, element, nodal, at, unknowns.number, unknowns.size, unknowns.width, self._sums
        )
        return float(square)


@vectorised
def assemble(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    nodal: NodalValues,
    at: Values,
    number: IntArray,
    matrix: Array,
    load: Array,
) -> bool:
    """Add the matrix and the load of every element.

    Row j of ``matrix``, of shape ``(unknowns, width + 1)``, has the entries of column j from the diagonal downwards.
    False where an element is folded.
    """
    count = elements.shape[1]
    corner, parts = np.empty((NODE_ROWS, count)), np.empty((2, count))
    local, right = np.empty((count, count)), np.empty(count)
    for c in range(elements.shape[0]):
        gather(nodes, nodal, elements[c], corner)
        local[:] = 0.0
        right[:] = 0.0
        if not add_system(element, c, corner, (at.u_x, at.u_y), parts, local, right):
            return False
        for k in range(count):
            row = number[nodes.corners[elements[c, k]]]
            if row < 0:
                continue
            load[row] += right[k]
            for j in range(k + 1):
                column = number[nodes.corners[elements[c, j]]]
                if column >= 0:
                    matrix[min(row, column), abs(row - column)] += local[k, j]
    return True


@vectorised
def factorise(matrix: Array) -> bool:
    """The Cholesky factor of a band matrix, in its place; False where the matrix is not positive definite."""
    count, band = matrix.shape
    for j in range(count):
        pivot = matrix[j, 0]
        if not pivot > 0.0:
            return False
        last = min(band, count - j)
        root = 1.0 / np.sqrt(pivot)
        for k in range(last):
            matrix[j, k] *= root
        for k in range(1, last):
            factor = matrix[j, k]
            if factor != 0.0:
                for i in range(last - k):
                    matrix[j + k, i] -= factor * matrix[j, k + i]
    return True


@vectorised
def substitute(matrix: Array, values: Array) -> None:
    """Solve with the factor of :func:`factorise`, in place of the right side ``values``."""
    count, band = matrix.shape
    for j in range(count):
        value = values[j] / matrix[j, 0]
        values[j] = value
        for k in range(1, min(band, count - j)):
            values[j + k] -= matrix[j, k] * value
    for j in range(count - 1, -1, -1):
        value = values[j]
        for k in range(1, min(band, count - j)):
            value -= matrix[j, k] * values[j + k]
        values[j] = value / matrix[j, 0]


@vectorised
def spread(number: IntArray, values: Array, out: Array) -> None:
    """The values at the nodes of those of the unknowns, 0 on the boundary."""
    for node in range(number.size):
        out[node] = values[number[node]] if number[node] >= 0 else 0.0


@vectorised
def load_of_errors(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    nodal: NodalValues,
    at: Values,
    number: IntArray,
    added: Array,
    load: Array,
) -> None:
    """Add the integrals of ``2 (u_h - u)`` times the shape function of each unknown."""
    shape, weights = element.shape, element.weights
    count = elements.shape[1]
    corner, right = np.empty((3, count)), np.empty(count)
    for c in range(elements.shape[0]):
        for k in range(count):
            node = nodes.corners[elements[c, k]]
            corner[0, k], corner[1, k], corner[2, k] = nodes.x[node], nodes.y[node], nodal.u[node] + added[node]
        right[:] = 0.0
        for q in range(weights.size):
            by, _, e = at_point(element, q, count, corner, 2, -at.u[q, c])
            area = 2.0 * weights[q] * determinant(by) * e
            for k in range(count):
                right[k] += area * shape[q, k]
        for k in range(count):
            row = number[nodes.corners[elements[c, k]]]
            if row >= 0:
                load[row] += right[k]


@vectorised
def add_errors(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    nodal: NodalValues,
    at: Values,
    added: Array,
    dual: Array,
    sums: Array,
) -> tuple[float, float]:
    """The integrals of the squared errors of the projection and of the interpolant; adds to the ``sums`` of the nodes.

    With e the error, N a shape function, z the dual solution and H the second derivatives of u, a corner has the share
    ``2 e N (grad u(corner) - grad u) + e^2 grad N`` of the first term, and of the second one
    ``(grad N . grad z) (grad u_h - grad u(corner)) + (grad N . grad e) grad z + N H grad z
    - (grad e . grad z) grad N``.
    """
    shape, along_s, along_t, weights = element
    total, plain, count = 0.0, 0.0, elements.shape[1]
    corner, own = np.empty((7, count)), np.empty((SUMS, count))
    for c in range(elements.shape[0]):
        for k in range(count):
            node = nodes.corners[elements[c, k]]
            corner[0, k], corner[1, k] = nodes.x[node], nodes.y[node]
            corner[2, k], corner[3, k], corner[4, k] = nodal.u[node], nodal.u_x[node], nodal.u_y[node]
            corner[5, k], corner[6, k] = nodal.u[node] + added[node], dual[node]
        own[:] = 0.0
        for q in range(weights.size):
            x_s, x_t, y_s, y_t, e, i = 0.0, 0.0, 0.0, 0.0, -at.u[q, c], -at.u[q, c]
            v_s, v_t, z_s, z_t = 0.0, 0.0, 0.0, 0.0
            for k in range(count):
                s, t = along_s[q, k], along_t[q, k]
                x_s += s * corner[0, k]
                x_t += t * corner[0, k]
                y_s += s * corner[1, k]
                y_t += t * corner[1, k]
                v_s += s * corner[5, k]
                v_t += t * corner[5, k]
                z_s += s * corner[6, k]
                z_t += t * corner[6, k]
                i += shape[q, k] * corner[2, k]
                e += shape[q, k] * corner[5, k]
            by = x_s, x_t, y_s, y_t
            det = determinant(by)
            per_det, area = 1.0 / det, weights[q] * det
            v_x, v_y = gradient(v_s, v_t, by, per_det)
            z_x, z_y = gradient(z_s, z_t, by, per_det)
            u_x, u_y = at.u_x[q, c], at.u_y[q, c]
            e_x, e_y = v_x - u_x, v_y - u_y
            bent_x = at.u_xx[q, c] * z_x + at.u_xy[q, c] * z_y
            bent_y = at.u_xy[q, c] * z_x + at.u_yy[q, c] * z_y
            product, square = e_x * z_x + e_y * z_y, e * e
            total += area * square
            plain += area * i * i
            for k in range(count):
                part = shape[q, k]
                n_x, n_y = gradient(along_s[q, k], along_t[q, k], by, per_det)
                g_x, g_y = corner[3, k], corner[4, k]
                d_x, d_y = g_x - u_x, g_y - u_y
                n_z, n_e = n_x * z_x + n_y * z_y, n_x * e_x + n_y * e_y
                own[0, k] += area * (
                    2.0 * e * part * d_x + (square - product) * n_x + n_z * (v_x - g_x) + n_e * z_x + part * bent_x
                )
                own[1, k] += area * (
                    2.0 * e * part * d_y + (square - product) * n_y + n_z * (v_y - g_y) + n_e * z_y + part * bent_y
                )
                factor = 2.0 * area * part * part
                own[2, k] += factor * d_x * d_x
                own[3, k] += factor * d_x * d_y
                own[4, k] += factor * d_y * d_y
        add_own(nodes, elements[c], own, sums)
    return total, plain


@vectorised
def projected_errors(
    nodes: Nodes,
    elements: IntArray,
    element: Element,
    nodal: NodalValues,
    at: Values,
    number: IntArray,
    count: int,
    width: int,
    sums: Array,
) -> float:
    """The integral of the squared error of the projection; adds its derivatives. Negative without a projection."""
    matrix, load = np.zeros((count, width + 1)), np.zeros(count)
    added, dual = np.zeros(number.size), np.zeros(number.size)
    if not assemble(nodes, elements, element, nodal, at, number, matrix, load) or not factorise(matrix):
        return -1.0
    substitute(matrix, load)
    spread(number, load, added)
    load[:] = 0.0
    load_of_errors(nodes, elements, element, nodal, at, number, added, load)
    substitute(matrix, load)
    spread(number, load, dual)
    total, plain = add_errors(nodes, elements, element, nodal, at, added, dual, sums)
    if plain > 0.0:
        sums[:, 2:] *= total / plain
    return total
