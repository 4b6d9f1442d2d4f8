"""Pieces of cells, on which the error of interpolation is integrated more finely than on the whole cell.

A part of a bilinear cell, from halving its edges, is a bilinear cell itself, and the interpolant of u is bilinear on
it, too. So a piece is known by its corners and by the values of the interpolant there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.fields.field import Field
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cells import BilinearCells, CellMap, CellPoints, gather_cells, map_cells

GAUSS_POINTS = 4
"""Gauss points per direction of a piece."""
RIM = CellPoints(
    np.array([0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0]),
    np.array([0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 0.5]),
    np.full(8, 0.125),
)
"""The corners and the middles of the edges, counter-clockwise from the first corner."""
BLOCK_PIECES = 1 << 10
"""Pieces of a block: its intermediate arrays stay in the cache."""
_QUARTERS = (
    np.array([[4, 0, 0, 0], [2, 2, 0, 0], [1, 1, 1, 1], [2, 0, 0, 2]]) / 4.0,
    np.array([[2, 2, 0, 0], [0, 4, 0, 0], [0, 2, 2, 0], [1, 1, 1, 1]]) / 4.0,
    np.array([[1, 1, 1, 1], [0, 2, 2, 0], [0, 0, 4, 0], [0, 0, 2, 2]]) / 4.0,
    np.array([[2, 0, 0, 2], [1, 1, 1, 1], [0, 0, 2, 2], [0, 0, 0, 4]]) / 4.0,
)  # the corners of the four parts of a piece, as means of its own corners


@dataclass(frozen=True, eq=False)
class Pieces:
    """Bilinear pieces of cells: ``corners`` of shape ``(8, n)``, x and then y, counter-clockwise.

    ``values`` of shape ``(4, n)`` are those of the interpolant at the corners.
    """

    corners: Array
    values: Array

    @classmethod
    def of(cls, cells: BilinearCells, numbers: IntArray, values: Array) -> Pieces:
        """Whole cells with these ``numbers``, and the ``values`` of u at their corners, of shape ``(4, n)``."""
        corners = np.empty((8, numbers.size))
        gather_cells(*cells.nodes, numbers, corners)
        return cls(corners, values)

    @property
    def count(self) -> int:
        """Number of pieces."""
        return int(self.corners.shape[1])

    def some(self, chosen: IntArray | BoolArray) -> Pieces:
        """The chosen pieces."""
        return Pieces(self.corners[:, chosen], self.values[:, chosen])

    def quarters(self) -> Pieces:
        """Four parts of every piece; part ``q`` of piece ``k`` has the number ``q * count + k``."""
        x, y = self.corners[:4], self.corners[4:]
        corners = np.concatenate([np.concatenate([part @ x, part @ y]) for part in _QUARTERS], axis=1)
        return Pieces(corners, np.concatenate([part @ self.values for part in _QUARTERS], axis=1))

    def errors(self, u: Field) -> Array:
        """Integrals over every piece, of shape ``(3, n)``.

        The first two are those of the squares of ``e = u_h - u`` and of its gradient. The third is what the gradient of
        u at the Gauss points has missed: the mean of ``grad e`` over a piece equals an integral of e over its rim, in
        which no derivative occurs. It is the squared difference of the two times the area, in the unit of the second.
        """
        result = np.empty((3, self.count))
        for start in range(0, self.count, BLOCK_PIECES):
            block = slice(start, start + BLOCK_PIECES)
            _block_errors(u, self.corners[:, block].copy(), self.values[:, block].copy(), result[:, block])
        return result


def _block_errors(u: Field, corners: Array, values: Array, result: Array) -> None:
    gauss, n = CellPoints.gauss(GAUSS_POINTS), corners.shape[1]
    count = gauss.s.size
    out = np.empty((7, count + RIM.s.size, n))
    map_cells(corners, np.concatenate([gauss.s, RIM.s]), np.concatenate([gauss.t, RIM.t]), out)
    everywhere, u_x, u_y = u.evaluate(out[0], out[1], order=1)
    at, there, rim = CellMap(*out[:, :count]), everywhere[:count], everywhere[count:]
    u_x, u_y = u_x[:count], u_y[:count]
    sums, mean = np.zeros((2, n)), np.zeros((2, n))
    add_values(values, there, gauss, at.det, sums[0], np.zeros(n))
    add_gradients(values, (u_x, u_y), gauss, at, sums[1], mean)
    result[:2] = sums
    missed_gradients(corners, values, rim, mean, result[2])


@compiled
def add_values(corner: Array, u: Array, points: CellPoints, det: Array, sums: Array, largest: Array) -> None:
    """To ``sums`` of every cell the weighted squares of the bilinear interpolant of ``corner`` values minus ``u``.

    ``largest`` becomes the largest size of the difference.
    """
    s, t, weights = points
    for p in range(u.shape[0]):
        a, b, c, d = (1.0 - s[p]) * (1.0 - t[p]), s[p] * (1.0 - t[p]), s[p] * t[p], (1.0 - s[p]) * t[p]
        for k in range(u.shape[1]):
            error = a * corner[0, k] + b * corner[1, k] + c * corner[2, k] + d * corner[3, k] - u[p, k]
            sums[k] += weights[p] * det[p, k] * error * error
            largest[k] = max(largest[k], abs(error))


@compiled
def add_gradients(corner: Array, gradient: Pair, points: CellPoints, at: CellMap, sums: Array, means: Array) -> None:
    """To ``sums`` of every cell the weighted squares of the gradient of the interpolant minus that of u.

    To ``means`` of shape ``(2, n)`` the weighted differences themselves.
    """
    (u_x, u_y), (s, t, weights) = gradient, points
    _, _, x_s, y_s, x_t, y_t, det = at
    for p in range(u_x.shape[0]):
        for k in range(u_x.shape[1]):
            along_s = (1.0 - t[p]) * (corner[1, k] - corner[0, k]) + t[p] * (corner[2, k] - corner[3, k])
            along_t = (1.0 - s[p]) * (corner[3, k] - corner[0, k]) + s[p] * (corner[2, k] - corner[1, k])
            per_det = 1.0 / det[p, k]
            error_x = (along_s * y_t[p, k] - along_t * y_s[p, k]) * per_det - u_x[p, k]
            error_y = (along_t * x_s[p, k] - along_s * x_t[p, k]) * per_det - u_y[p, k]
            share = weights[p] * det[p, k]
            sums[k] += share * (error_x * error_x + error_y * error_y)
            means[0, k] += share * error_x
            means[1, k] += share * error_y


@compiled
def missed_gradients(corners: Array, values: Array, rim: Array, mean: Array, missed: Array) -> None:
    """``missed`` of every piece: the square of ``mean``, minus the integral of ``e n`` over the rim, by its area.

    ``rim`` of shape ``(8, n)`` holds u at the points :data:`RIM`. The integral along an edge is by Simpson's rule.
    """
    for k in range(missed.size):
        total_x, total_y, area = mean[0, k], mean[1, k], 0.0
        for side in range(4):
            after = (side + 1) % 4
            dx, dy = corners[after, k] - corners[side, k], corners[4 + after, k] - corners[4 + side, k]
            first, last = values[side, k] - rim[2 * side, k], values[after, k] - rim[(2 * side + 2) % 8, k]
            middle = 0.5 * (values[side, k] + values[after, k]) - rim[2 * side + 1, k]
            along = (first + 4.0 * middle + last) / 6.0
            total_x -= along * dy
            total_y += along * dx
            area += 0.5 * (corners[side, k] * corners[4 + after, k] - corners[after, k] * corners[4 + side, k])
        missed[k] = (total_x * total_x + total_y * total_y) / area
