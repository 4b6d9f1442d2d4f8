"""Pieces of cells, on which the error of interpolation is integrated more finely than on the whole cell.

A part of a bilinear cell, from halving its edges, is a bilinear cell itself, and the interpolant of u is bilinear on
it, too. So a piece is known by its corners and by the values of the interpolant there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.fields.field import Field
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray
from equimesh.quality.cell_errors import add_errors
from equimesh.quality.cell_maps import locate
from equimesh.quality.cells import CellPoints, Cells

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
    def of(cls, cells: Cells, numbers: IntArray, values: Array) -> Pieces:
        """Whole cells with these ``numbers``, and the ``values`` of u at their corners, of shape ``(4, n)``."""
        return cls(cells.corners(numbers), values)

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
    x, y = np.empty((2, count + RIM.s.size, n))
    locate(corners, np.concatenate([gauss.s, RIM.s]), np.concatenate([gauss.t, RIM.t]), x, y)
    everywhere, u_x, u_y = (np.ascontiguousarray(part) for part in u.evaluate(x, y, order=1))
    sums = np.zeros((4, n))
    add_errors(corners, values, everywhere[:count], (u_x[:count], u_y[:count]), gauss, sums, np.zeros(n))
    result[:2] = sums[:2]
    missed_gradients(corners, values, everywhere[count:], sums[2:], result[2])


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
