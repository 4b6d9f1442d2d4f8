"""The objective of a mesh for a solver: the error of the Ritz projection of u in place of that of the interpolant.

The solution ``u_h = I u + w`` of linear or bilinear elements for Poisson's equation satisfies
``a(w, v) = a(u - I u, v)`` for all v that vanish on the boundary, with ``a(u, v)`` the integral of ``grad u . grad v``.
The derivative of the integral of ``(u_h - u)^2`` by the nodes needs one more solution with the same matrix. With z the
solution of ``a(v, z) = 2 (u_h - u, v)`` it is the derivative of ``|u_h - u|^2 - a(u_h - u, z)`` while w and z are held
at the nodes.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy

from equimesh.least_error.cells import Cells
from equimesh.least_error.kernels import CELLS_AT_ONCE, SUMS, NodalValues, Nodes, Values
from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import Element, determinant, gradient
from equimesh.quality.ritz import unknowns

MAX_CACHED = 16
"""Meshes whose unknowns are kept: the levels of one or two solves."""
MAX_WORK = 4.5e7
"""Unknowns times the square of the width of their band, at most: a grid of 81 x 81 points has as much."""
MAX_CELLS = 12_000
"""Cells, at most, of a mesh whose unknowns are put in order."""
CORNER_ROWS = 7
"""Rows of each corner in the array of :data:`~equimesh.least_error.kernels.CELLS_AT_ONCE` elements.

They are x, y, the solution, the dual solution, u and its gradient."""
POINT_ROWS = 4 * CORNER_ROWS
"""The first row of u and its derivatives at the points."""
SUM_ROWS = POINT_ROWS + 6
"""The first row of the sums."""
Quadruple: TypeAlias = tuple[float, float, float, float]


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


def matrix_for(unknowns: Unknowns) -> Array:
    """Memory for the matrix of a solver with these unknowns."""
    return np.empty((unknowns.size, unknowns.width + 1))


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


def of_four_corners(elements: IntArray, element: Element) -> tuple[IntArray, Element]:
    """The elements with four corners each: of a triangle the last one is there twice, and counts once."""
    if elements.shape[1] == 4:
        return elements, element
    none = np.zeros((element.weights.size, 1))
    shape, along_s, along_t = (np.concatenate([part, none], axis=1) for part in element[:3])
    padded = Element(shape, along_s, along_t, element.weights)
    return np.concatenate([elements, elements[:, -1:]], axis=1), padded


class Places(NamedTuple):
    """Where u is known: the nodes, the nodes of the elements, u at the nodes, and u at the points of the elements."""

    nodes: Nodes
    elements: IntArray
    """The corners ``4 cell + corner`` of each element, shape ``(elements, 4)``."""
    nodal: NodalValues
    at: Values


@compiled
def are_finite(values: Values) -> bool:
    """Whether u and its derivatives are finite at all points."""
    others = 0
    for part in values:
        for q in range(part.shape[0]):
            row = part[q]
            for j in range(row.size):
                others += 0 if row[j] - row[j] == 0.0 else 1
    return others == 0


@inlined
def fill_batch(places: Places, first: int, size: int, added: Array, dual: Array, batch: Array) -> None:
    """Gather what ``size`` elements have at their corners, see :data:`CORNER_ROWS`, and set their sums to 0."""
    m = CELLS_AT_ONCE
    for j in range(size):
        for k in range(4):
            node, at = places.nodes.corners[places.elements[first + j, k]], CORNER_ROWS * k * m + j
            batch[at], batch[at + m] = places.nodes.x[node], places.nodes.y[node]
            batch[at + 2 * m], batch[at + 3 * m] = places.nodal.u[node] + added[node], dual[node]
            batch[at + 4 * m], batch[at + 5 * m] = places.nodal.u[node], places.nodal.u_x[node]
            batch[at + 6 * m] = places.nodal.u_y[node]
    for j in range(SUM_ROWS * m, batch.size):
        batch[j] = 0.0


@inlined
def at_corners(batch: Array, at: int, factors: Quadruple) -> float:
    """The sum of the factors times one row of the four corners."""
    step = CORNER_ROWS * CELLS_AT_ONCE
    half = factors[0] * batch[at] + factors[1] * batch[at + step]
    return float(half + factors[2] * batch[at + 2 * step] + factors[3] * batch[at + 3 * step])


@inlined
def moved(batch: Array, j: int, s: Quadruple, t: Quadruple) -> Quadruple:
    """The derivatives of the map of the j-th element: of x by s and t, and of y."""
    y = CELLS_AT_ONCE + j
    return at_corners(batch, j, s), at_corners(batch, j, t), at_corners(batch, y, s), at_corners(batch, y, t)


@inlined
def functions_of(values: Array, q: int) -> Quadruple:
    """Shape functions of the corners, or their derivatives, at a point."""
    return values[q, 0], values[q, 1], values[q, 2], values[q, 3]


@vectorised
def assemble(places: Places, element: Element, number: IntArray, matrix: Array, load: Array) -> bool:
    """Add the matrix and the load of every element.

    Row j of ``matrix``, of shape ``(unknowns, width + 1)``, has the entries of column j from the diagonal downwards.
    False where an element is folded.
    """
    _, along_s, along_t, weights = element
    m, folded, none = CELLS_AT_ONCE, 0.0, np.zeros(number.size)
    batch = np.empty((SUM_ROWS + 14) * m)
    for first in range(0, places.elements.shape[0], m):
        size = min(m, places.elements.shape[0] - first)
        fill_batch(places, first, size, none, none, batch)
        for q in range(weights.size):
            s, t, weight = functions_of(along_s, q), functions_of(along_t, q), weights[q]
            for j in range(size):
                batch[POINT_ROWS * m + j] = places.at.u_x[q, first + j]
                batch[(POINT_ROWS + 1) * m + j] = places.at.u_y[q, first + j]
            for j in range(size):
                by = moved(batch, j, s, t)
                det = determinant(by)
                folded += 1.0 if det <= 0.0 else 0.0
                share, own = weight / det, SUM_ROWS * m + j
                v_x, v_y = gradient(at_corners(batch, 2 * m + j, s), at_corners(batch, 2 * m + j, t), by, share)
                e_x = weight * batch[POINT_ROWS * m + j] - v_x
                e_y = weight * batch[(POINT_ROWS + 1) * m + j] - v_y
                a_x, a_y = gradient(s[0], t[0], by, 1.0)
                b_x, b_y = gradient(s[1], t[1], by, 1.0)
                c_x, c_y = gradient(s[2], t[2], by, 1.0)
                d_x, d_y = gradient(s[3], t[3], by, 1.0)
                batch[own] += share * (a_x * a_x + a_y * a_y)
                batch[own + m] += share * (b_x * a_x + b_y * a_y)
                batch[own + 2 * m] += share * (b_x * b_x + b_y * b_y)
                batch[own + 3 * m] += share * (c_x * a_x + c_y * a_y)
                batch[own + 4 * m] += share * (c_x * b_x + c_y * b_y)
                batch[own + 5 * m] += share * (c_x * c_x + c_y * c_y)
                batch[own + 6 * m] += share * (d_x * a_x + d_y * a_y)
                batch[own + 7 * m] += share * (d_x * b_x + d_y * b_y)
                batch[own + 8 * m] += share * (d_x * c_x + d_y * c_y)
                batch[own + 9 * m] += share * (d_x * d_x + d_y * d_y)
                batch[own + 10 * m] += e_x * a_x + e_y * a_y
                batch[own + 11 * m] += e_x * b_x + e_y * b_y
                batch[own + 12 * m] += e_x * c_x + e_y * c_y
                batch[own + 13 * m] += e_x * d_x + e_y * d_y
        if folded > 0.0:
            return False
        for j in range(size):
            entry = SUM_ROWS * m + j
            for k in range(4):
                row = number[places.nodes.corners[places.elements[first + j, k]]]
                if row >= 0:
                    load[row] += batch[(SUM_ROWS + 10 + k) * m + j]
                for i in range(k + 1):
                    column = number[places.nodes.corners[places.elements[first + j, i]]]
                    if row >= 0 and column >= 0:
                        matrix[min(row, column), abs(row - column)] += batch[entry]
                    entry += m
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
def load_of_errors(places: Places, element: Element, number: IntArray, added: Array, load: Array) -> None:
    """Add the integrals of ``2 (u_h - u)`` times the shape function of each unknown."""
    shape, along_s, along_t, weights = element
    m = CELLS_AT_ONCE
    batch = np.empty((SUM_ROWS + 4) * m)
    for first in range(0, places.elements.shape[0], m):
        size = min(m, places.elements.shape[0] - first)
        fill_batch(places, first, size, added, added, batch)
        for q in range(weights.size):
            n, s, t = functions_of(shape, q), functions_of(along_s, q), functions_of(along_t, q)
            for j in range(size):
                batch[POINT_ROWS * m + j] = places.at.u[q, first + j]
            for j in range(size):
                e = at_corners(batch, 2 * m + j, n) - batch[POINT_ROWS * m + j]
                area, own = 2.0 * weights[q] * determinant(moved(batch, j, s, t)) * e, SUM_ROWS * m + j
                batch[own] += area * n[0]
                batch[own + m] += area * n[1]
                batch[own + 2 * m] += area * n[2]
                batch[own + 3 * m] += area * n[3]
        for j in range(size):
            for k in range(4):
                row = number[places.nodes.corners[places.elements[first + j, k]]]
                if row >= 0:
                    load[row] += batch[(SUM_ROWS + k) * m + j]


@vectorised
def add_errors(places: Places, element: Element, added: Array, dual: Array, sums: Array) -> tuple[float, float]:
    """The integrals of the squared errors of the projection and of the interpolant; adds to the ``sums`` of the nodes.

    With e the error, N a shape function, z the dual solution and H the second derivatives of u, a corner has the share
    ``2 e N (grad u(corner) - grad u) + e^2 grad N`` of the first term, and of the second one
    ``(grad N . grad z) (grad u_h - grad u(corner)) + (grad N . grad e) grad z + N H grad z
    - (grad e . grad z) grad N``.
    """
    shape, along_s, along_t, weights = element
    m, total, plain = CELLS_AT_ONCE, 0.0, 0.0
    batch = np.empty((SUM_ROWS + 4 * SUMS) * m)
    for first in range(0, places.elements.shape[0], m):
        size = min(m, places.elements.shape[0] - first)
        fill_batch(places, first, size, added, dual, batch)
        for q in range(weights.size):
            n, s, t, weight = functions_of(shape, q), functions_of(along_s, q), functions_of(along_t, q), weights[q]
            for j in range(size):
                here = POINT_ROWS * m + j
                batch[here], batch[here + m] = places.at.u[q, first + j], places.at.u_x[q, first + j]
                batch[here + 2 * m], batch[here + 3 * m] = places.at.u_y[q, first + j], places.at.u_xx[q, first + j]
                batch[here + 4 * m], batch[here + 5 * m] = places.at.u_xy[q, first + j], places.at.u_yy[q, first + j]
            for j in range(size):
                here = POINT_ROWS * m + j
                by = moved(batch, j, s, t)
                e, i = at_corners(batch, 2 * m + j, n) - batch[here], at_corners(batch, 4 * m + j, n) - batch[here]
                det = determinant(by)
                per_det, area = 1.0 / det, weight * det
                v_x, v_y = gradient(at_corners(batch, 2 * m + j, s), at_corners(batch, 2 * m + j, t), by, per_det)
                z_x, z_y = gradient(at_corners(batch, 3 * m + j, s), at_corners(batch, 3 * m + j, t), by, per_det)
                u_x, u_y = batch[here + m], batch[here + 2 * m]
                e_x, e_y = v_x - u_x, v_y - u_y
                bent_x = batch[here + 3 * m] * z_x + batch[here + 4 * m] * z_y
                bent_y = batch[here + 4 * m] * z_x + batch[here + 5 * m] * z_y
                total += area * e * e
                plain += area * i * i
                at_point = At(u_x, u_y, v_x, v_y, z_x, z_y, e_x, e_y, bent_x, bent_y, e, area)
                add_corner(batch, j, 0, n[0], gradient(s[0], t[0], by, per_det), at_point)
                add_corner(batch, j, 1, n[1], gradient(s[1], t[1], by, per_det), at_point)
                add_corner(batch, j, 2, n[2], gradient(s[2], t[2], by, per_det), at_point)
                add_corner(batch, j, 3, n[3], gradient(s[3], t[3], by, per_det), at_point)
        for j in range(size):
            for k in range(4):
                node = places.nodes.corners[places.elements[first + j, k]]
                for entry in range(SUMS):
                    sums[node, entry] += batch[(SUM_ROWS + SUMS * k + entry) * m + j]
    return total, plain


class At(NamedTuple):
    """What a point has for all corners: gradients of u, u_h, z and the error, H grad z, the error, and the area."""

    u_x: float
    u_y: float
    v_x: float
    v_y: float
    z_x: float
    z_y: float
    e_x: float
    e_y: float
    bent_x: float
    bent_y: float
    e: float
    area: float


@inlined
def add_corner(batch: Array, j: int, k: int, part: float, slope: tuple[float, float], here: At) -> None:
    """Add what a point has for corner k, of the shape function ``part`` with this ``slope``, see :func:`add_errors`."""
    m = CELLS_AT_ONCE
    base, own, (n_x, n_y) = CORNER_ROWS * k * m + j, (SUM_ROWS + SUMS * k) * m + j, slope
    g_x, g_y = batch[base + 5 * m], batch[base + 6 * m]
    d_x, d_y = g_x - here.u_x, g_y - here.u_y
    n_z, n_e = n_x * here.z_x + n_y * here.z_y, n_x * here.e_x + n_y * here.e_y
    rest = here.e * here.e - here.e_x * here.z_x - here.e_y * here.z_y
    twice, factor = 2.0 * here.e * part, 2.0 * here.area * part * part
    batch[own] += here.area * (twice * d_x + rest * n_x + n_z * (here.v_x - g_x) + n_e * here.z_x + part * here.bent_x)
    batch[own + m] += here.area * (
        twice * d_y + rest * n_y + n_z * (here.v_y - g_y) + n_e * here.z_y + part * here.bent_y
    )
    batch[own + 2 * m] += factor * d_x * d_x
    batch[own + 3 * m] += factor * d_x * d_y
    batch[own + 4 * m] += factor * d_y * d_y


@vectorised
def projected_errors(places: Places, element: Element, number: IntArray, matrix: Array, sums: Array) -> float:
    """The integral of the squared error of the projection; adds its derivatives. Negative without a projection.

    ``matrix`` of shape ``(unknowns, width + 1)`` is memory of zeros.
    """
    load, added, dual = np.zeros(matrix.shape[0]), np.zeros(number.size), np.zeros(number.size)
    if not assemble(places, element, number, matrix, load) or not factorise(matrix):
        return -1.0
    substitute(matrix, load)
    spread(number, load, added)
    load[:] = 0.0
    load_of_errors(places, element, number, added, load)
    substitute(matrix, load)
    spread(number, load, dual)
    total, plain = add_errors(places, element, added, dual, sums)
    if plain > 0.0:
        share = total / plain
        for k in range(sums.shape[0]):
            for column in range(2, sums.shape[1]):
                sums[k, column] *= share
    return total
