"""The compiled loops of the objective: error, distortion and smoothness of a mesh with their derivatives.

A cell hands its share of a derivative to each of its corners, and every node collects the shares of its cells. Cells
can then be visited in any order, on any number of threads, and the sums are always the same.

For a corner of a cell there are five shares: the derivatives by x and y, and the entries ``(xx, xy, yy)`` of a positive
semidefinite approximation of the second derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from equimesh.numerics.compiled import compiled, inlined, vectorised
from equimesh.numerics.types import Array, IntArray, Pair
from equimesh.quality.elements import Basis, CellKind, Element, basis, quadrilateral, triangle
from equimesh_coupling.parts import ANYWHERE, CUTS, better_cuts

SHARES = 5
"""Shares of a corner: derivatives by x and y, and the three second derivatives."""


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
def place_points(nodes: Nodes, elements: IntArray, shape: Array, out_x: Array, out_y: Array) -> None:
    """The quadrature points of ``elements``, of shape ``(elements, points)``."""
    x, y, corners = nodes
    for c in range(elements.shape[0]):
        for q in range(shape.shape[0]):
            px, py = 0.0, 0.0
            for k in range(elements.shape[1]):
                node = corners[elements[c, k]]
                px += shape[q, k] * x[node]
                py += shape[q, k] * y[node]
            out_x[c, q], out_y[c, q] = px, py


@inlined
def gather(nodes: Nodes, nodal: NodalValues, element: IntArray, corner: Array) -> None:
    """x, y, u and its gradient at the corners of an element, in the rows of ``corner``, shape ``(5, corners)``."""
    for k in range(element.size):
        node = nodes.corners[element[k]]
        corner[0, k], corner[1, k] = nodes.x[node], nodes.y[node]
        corner[2, k], corner[3, k], corner[4, k] = nodal.u[node], nodal.u_x[node], nodal.u_y[node]


@vectorised
def value_errors(
    nodes: Nodes, elements: IntArray, element: Element, nodal: NodalValues, at: NodalValues, shares: Array
) -> float:
    """The integral of the squared error of the interpolant; adds the shares of its derivatives.

    With e the error at a point, N the shape function of a corner and grad N its gradient, the derivative by the
    position of the corner is ``2 e N (grad u(corner) - grad u(point)) + e^2 grad N``, integrated over the cell.
    """
    shape, along_s, along_t, weights = element
    total, count = 0.0, elements.shape[1]
    corner, sums = np.empty((5, count)), np.empty((SHARES, count))
    for c in range(elements.shape[0]):
        gather(nodes, nodal, elements[c], corner)
        sums[:] = 0.0
        for q in range(weights.size):
            x_s, x_t, y_s, y_t, e = 0.0, 0.0, 0.0, 0.0, -at.u[c, q]
            for k in range(count):
                x_s += along_s[q, k] * corner[0, k]
                x_t += along_t[q, k] * corner[0, k]
                y_s += along_s[q, k] * corner[1, k]
                y_t += along_t[q, k] * corner[1, k]
                e += shape[q, k] * corner[2, k]
            area, square = weights[q] * (x_s * y_t - x_t * y_s), weights[q] * e * e
            total += area * e * e
            for k in range(count):
                part, factor = shape[q, k], 2.0 * area * shape[q, k]
                d_x, d_y = corner[3, k] - at.u_x[c, q], corner[4, k] - at.u_y[c, q]
                sums[0, k] += factor * e * d_x + square * (along_s[q, k] * y_t - along_t[q, k] * y_s)
                sums[1, k] += factor * e * d_y + square * (along_t[q, k] * x_s - along_s[q, k] * x_t)
                sums[2, k] += factor * part * d_x * d_x
                sums[3, k] += factor * part * d_x * d_y
                sums[4, k] += factor * part * d_y * d_y
        for k in range(count):
            for entry in range(SHARES):
                shares[elements[c, k], entry] += sums[entry, k]
    return total


@vectorised
def slope_errors(
    nodes: Nodes, elements: IntArray, element: Element, nodal: NodalValues, at: Values, shares: Array
) -> float:
    """The integral of the squared error of the interpolant's gradient; adds the shares of its derivatives.

    With e the error of the gradient, H the second derivatives of u and v the gradient of the interpolant, the
    derivative by a corner is ``2 ((e . grad N) (grad u(corner) - v) - N H e) + |e|^2 grad N``, integrated.
    """
    shape, along_s, along_t, weights = element
    total, count = 0.0, elements.shape[1]
    corner, sums = np.empty((5, count)), np.empty((SHARES, count))
    for c in range(elements.shape[0]):
        gather(nodes, nodal, elements[c], corner)
        sums[:] = 0.0
        for q in range(weights.size):
            x_s, x_t, y_s, y_t, v_s, v_t = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(count):
                x_s += along_s[q, k] * corner[0, k]
                x_t += along_t[q, k] * corner[0, k]
                y_s += along_s[q, k] * corner[1, k]
                y_t += along_t[q, k] * corner[1, k]
                v_s += along_s[q, k] * corner[2, k]
                v_t += along_t[q, k] * corner[2, k]
            det = x_s * y_t - x_t * y_s
            per_det, area = 1.0 / det, weights[q] * det
            v_x, v_y = (v_s * y_t - v_t * y_s) * per_det, (v_t * x_s - v_s * x_t) * per_det
            e_x, e_y = v_x - at.u_x[c, q], v_y - at.u_y[c, q]
            xx, xy, yy = at.u_xx[c, q], at.u_xy[c, q], at.u_yy[c, q]
            bent_x, bent_y, square = xx * e_x + xy * e_y, xy * e_x + yy * e_y, e_x * e_x + e_y * e_y
            total += area * square
            for k in range(count):
                part = shape[q, k]
                n_x = (along_s[q, k] * y_t - along_t[q, k] * y_s) * per_det
                n_y = (along_t[q, k] * x_s - along_s[q, k] * x_t) * per_det
                d_x, d_y, along = corner[3, k] - v_x, corner[4, k] - v_y, e_x * n_x + e_y * n_y
                sums[0, k] += area * (2.0 * (along * d_x - part * bent_x) + square * n_x)
                sums[1, k] += area * (2.0 * (along * d_y - part * bent_y) + square * n_y)
                # The change of e with the position is the matrix grad N d^T - N H.
                a, b = n_x * d_x - part * xx, n_x * d_y - part * xy
                f, g = n_y * d_x - part * xy, n_y * d_y - part * yy
                sums[2, k] += 2.0 * area * (a * a + f * f)
                sums[3, k] += 2.0 * area * (a * b + f * g)
                sums[4, k] += 2.0 * area * (b * b + g * g)
        for k in range(count):
            for entry in range(SHARES):
                shares[elements[c, k], entry] += sums[entry, k]
    return total


@compiled
def distortions(nodes: Nodes, start: Nodes, cells: tuple[int, int], weight: float, shares: Array) -> float:
    """The sum of ``(r^2 - 1) / 2`` over the corners of a range of ``cells``; adds ``weight`` times its derivatives.

    A corner has the edges a and b, and those of the ``start`` a0 and b0. With ``A = [a b] [a0 b0]^-1`` it has
    ``r = |A|^2 / (2 det A)``: at least 1, which is a similarity, and unbounded towards a fold. Infinite where a corner
    is folded.
    """
    x, y, corners = nodes
    x0, y0, _ = start
    total = 0.0
    for cell in range(cells[0], cells[1]):
        for k in range(4):
            here, ahead, behind = 4 * cell + k, 4 * cell + (k + 1) % 4, 4 * cell + (k + 3) % 4
            p, n, m = corners[here], corners[ahead], corners[behind]
            ax, ay, bx, by = x[n] - x[p], y[n] - y[p], x[m] - x[p], y[m] - y[p]
            cx, cy, dx, dy = x0[n] - x0[p], y0[n] - y0[p], x0[m] - x0[p], y0[m] - y0[p]
            det0, det = cx * dy - cy * dx, ax * by - ay * bx
            if not det > 0.0:
                return np.inf
            per_det0, per_det = 1.0 / det0, 1.0 / det
            k00, k01, k10, k11 = dy * per_det0, -dx * per_det0, -cy * per_det0, cx * per_det0
            a00, a01 = ax * k00 + bx * k10, ax * k01 + bx * k11
            a10, a11 = ay * k00 + by * k10, ay * k01 + by * k11
            inverse = det0 * per_det  # of det A
            r = 0.5 * (a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11) * inverse
            total += 0.5 * (r * r - 1.0)
            # The derivatives of the logarithm of det by a and by b, then those of r.
            na, ma, nb, mb = by * per_det, -bx * per_det, -ay * per_det, ax * per_det
            ga, ha = (a00 * k00 + a01 * k01) * inverse - r * na, (a10 * k00 + a11 * k01) * inverse - r * ma
            gb, hb = (a00 * k10 + a01 * k11) * inverse - r * nb, (a10 * k10 + a11 * k11) * inverse - r * mb
            add_corner(shares, ahead, weight, r, (ga, ha), (na, ma), (k00 * k00 + k01 * k01) * inverse)
            add_corner(shares, behind, weight, r, (gb, hb), (nb, mb), (k10 * k10 + k11 * k11) * inverse)
            size = ((k00 + k10) * (k00 + k10) + (k01 + k11) * (k01 + k11)) * inverse
            add_corner(shares, here, weight, r, (-ga - gb, -ha - hb), (-na - nb, -ma - mb), size)
    return total


Direction: TypeAlias = tuple[float, float]


@inlined
def add_corner(
    shares: Array, at: int, weight: float, r: float, slope: Direction, stretch: Direction, size: float
) -> None:
    """Adds the derivatives of ``(r^2 - 1) / 2`` by one node, from those of r and of the logarithm of the Jacobian."""
    (g, h), (a, b) = slope, stretch
    shares[at, 0] += weight * r * g
    shares[at, 1] += weight * r * h
    shares[at, 2] += weight * (r * size + 2.0 * r * r * a * a + g * g)
    shares[at, 3] += weight * (2.0 * r * r * a * b + g * h)
    shares[at, 4] += weight * (r * size + 2.0 * r * r * b * b + h * h)


@compiled
def oblique_corners(nodes: Nodes, cells: tuple[int, int], limit: float, weight: float, shares: Array) -> float:
    """The sum of ``max(|c| - limit, 0)^2 / 2`` over the corners of a range of ``cells``, c the cotangent of the angle.

    Adds ``weight`` times its derivatives. Corners whose angles are within the limit have no share. Infinite where a
    corner is folded.
    """
    x, y, corners = nodes
    total = 0.0
    for cell in range(cells[0], cells[1]):
        for k in range(4):
            here, ahead, behind = 4 * cell + k, 4 * cell + (k + 1) % 4, 4 * cell + (k + 3) % 4
            p, n, m = corners[here], corners[ahead], corners[behind]
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
            add_slope(shares, ahead, weight, over, ga, ha)
            add_slope(shares, behind, weight, over, gb, hb)
            add_slope(shares, here, weight, over, -ga - gb, -ha - hb)
    return total


@inlined
def add_slope(shares: Array, at: int, weight: float, over: float, g: float, h: float) -> None:
    """Adds the derivatives of half a square by one node, from the root ``over`` and its derivatives g and h."""
    shares[at, 0] += weight * over * g
    shares[at, 1] += weight * over * h
    shares[at, 2] += weight * g * g
    shares[at, 3] += weight * g * h
    shares[at, 4] += weight * h * h


@vectorised
def collect(shares: Array, starts: IntArray, places: IntArray, nodes: tuple[int, int], out: Array) -> None:
    """The sums over the cells of a range of ``nodes``, in ``out`` of shape ``(5, nodes)``.

    ``places`` are the corners that each node is; those of node k begin at ``starts[k]``.
    """
    for node in range(nodes[0], nodes[1]):
        a, b, c, d, e = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(starts[node], starts[node + 1]):
            place = places[k]
            a += shares[place, 0]
            b += shares[place, 1]
            c += shares[place, 2]
            d += shares[place, 3]
            e += shares[place, 4]
        out[0, node], out[1, node], out[2, node], out[3, node], out[4, node] = a, b, c, d, e


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


@vectorised
def solve_blocks(blocks: Array, right: Array, out: Array) -> None:
    """The solutions of 2 x 2 systems with the matrices ``(ss, st, tt)`` of every node.

    ``right`` and ``out`` have shape ``(2 nodes,)``: first those along s.
    """
    count = blocks.shape[1]
    for k in range(count):
        a, b, d = blocks[0, k], blocks[1, k], blocks[2, k]
        one, other, det = right[k], right[count + k], a * d - b * b
        out[k] = (d * one - b * other) / det
        out[count + k] = (a * other - b * one) / det


# The loops below take the place of the linear algebra of NumPy: that shares a product of long arrays among all
# processors, where the threads wait for each other for longer than they work.


@vectorised
def product(one: Array, other: Array) -> float:
    """The inner product of two flat arrays."""
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@vectorised
def add_multiple(factor: float, added: Array, out: Array, other: Array) -> float:
    """Add ``factor`` times ``added`` to ``out``, all of them flat; the inner product of the result with ``other``."""
    total = 0.0
    for k in range(out.size):
        out[k] += factor * added[k]
        total += out[k] * other[k]
    return total


@vectorised
def keep_pair(pair: Pair, before: Array, after: Array, slope: Array, slope_then: Array) -> tuple[float, float, float]:
    """The move from ``before`` to ``after`` and the change of the gradient, in the ``pair`` of flat arrays.

    Returns their inner product, and that of each with itself.
    """
    move, change = pair
    mixed, of_move, of_change = 0.0, 0.0, 0.0
    for k in range(move.size):
        m, c = after[k] - before[k], slope_then[k] - slope[k]
        move[k], change[k] = m, c
        mixed += m * c
        of_move += m * m
        of_change += c * c
    return mixed, of_move, of_change


@vectorised
def quasi_newton_direction(
    moves: Array, changes: Array, products: Array, added: int, blocks: Array, gradient: Array, out: Array
) -> None:
    """The approximate inverse of the second derivatives times the ``gradient``, of shape ``(2 nodes,)`` as ``out``.

    The two loops of L-BFGS over the last of ``added`` pairs, in turn in the rows of ``moves`` and ``changes``, with
    their ``products``. All rows but one are used. The first matrix is that of the ``blocks``, scaled by the last pair.
    """
    kept = moves.shape[0]
    pairs, rest, shares = min(added, kept - 1), gradient.copy(), np.empty(kept)
    if pairs == 0:
        solve_blocks(blocks, rest, out)
        return
    last = (added - 1) % kept
    along = product(moves[last], rest)
    for k in range(pairs):
        row, older = (added - 1 - k) % kept, (added - 2 - k) % kept
        shares[k] = along / products[row]
        along = add_multiple(-shares[k], changes[row], rest, moves[older])
    solve_blocks(blocks, changes[last], out)
    scale, oldest = products[last] / product(changes[last], out), (added - pairs) % kept
    solve_blocks(blocks, rest, out)
    for k in range(out.size):
        out[k] *= scale
    along = product(changes[oldest], out)
    for k in range(pairs - 1, -1, -1):
        row, newer = (added - 1 - k) % kept, (added - k) % kept
        along = add_multiple(shares[k] - along / products[row], moves[row], out, changes[newer])


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
