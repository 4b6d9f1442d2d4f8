"""The interpolation error of u on any mesh of triangles or quadrilaterals. Independent of the solver."""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Function: TypeAlias = Callable[[Array, Array], Array]
FunctionWithGradient: TypeAlias = Callable[[Array, Array], tuple[Array, ...]]

POINTS = 6


class _GaussPoint(NamedTuple):
    """One Gauss point of every cell.

    ``weights`` and the coordinates ``x`` and ``y`` have one entry for each cell. ``value`` and ``gradient`` give the
    interpolant of values at the four corners, of shape ``(cells, 4)``, and its gradient.
    """

    weights: Array
    x: Array
    y: Array
    shape: Array
    by_s: Array
    by_t: Array
    edges: tuple[Array, Array]
    area: Array

    def value(self, corners: Array) -> Array:
        """The interpolant of values at the corners."""
        interpolant: Array = corners @ self.shape
        return interpolant

    def gradient(self, corners: Array) -> tuple[Array, Array]:
        """Its partial derivatives with respect to x and y."""
        along, across = corners @ self.by_s, corners @ self.by_t
        (x_s, y_s), (x_t, y_t) = self.edges[0].T, self.edges[1].T
        return (along * y_t - across * y_s) / self.area, (across * x_s - along * x_t) / self.area


def l2_error(points: Array, cells: IntArray, u: Function, count: int = POINTS) -> float:
    """The L2 norm of u minus its interpolant at the vertices, linear on triangles and bilinear on quadrilaterals.

    ``points`` has shape ``(v, 2)``, ``cells`` ``(c, 3)`` or ``(c, 4)``, counter-clockwise; ``count`` Gauss points a
    direction. A triangle is a quadrilateral whose last two vertices coincide: the bilinear map is then Duffy's, and the
    interpolant linear.
    """
    corners = _corners(cells)
    values, total = u(points[:, 0], points[:, 1])[corners], 0.0
    for point in _gauss_points(points[corners], count):
        total += float(point.weights @ (point.value(values) - u(point.x, point.y)) ** 2)
    return math.sqrt(total)


def errors(points: Array, cells: IntArray, u: FunctionWithGradient, count: int = POINTS) -> tuple[float, float]:
    """The L2 norm of u minus its interpolant, as in :func:`l2_error`, and that of the gradient of this difference.

    ``u`` returns the values of u and of its two partial derivatives.
    """
    corners = _corners(cells)
    values, squares = u(points[:, 0], points[:, 1])[0][corners], np.zeros(2)
    for point in _gauss_points(points[corners], count):
        exact, by_x, by_y = u(point.x, point.y)
        slope_x, slope_y = point.gradient(values)
        squares[0] += point.weights @ (point.value(values) - exact) ** 2
        squares[1] += point.weights @ ((slope_x - by_x) ** 2 + (slope_y - by_y) ** 2)
    l2, h1 = np.sqrt(squares)
    return float(l2), float(h1)


def _corners(cells: IntArray) -> IntArray:
    return cells[:, [0, 1, 2, 2]] if cells.shape[1] == 3 else cells


def _gauss_points(nodes: Array, count: int) -> Iterator[_GaussPoint]:
    """The Gauss points of cells with these corners, of shape ``(cells, 4, 2)``: one point of every cell at a time."""
    places, weights = np.polynomial.legendre.leggauss(count)
    places, weights = 0.5 * (places + 1.0), 0.5 * weights
    for s, along in zip(places, weights, strict=True):
        for t, across in zip(places, weights, strict=True):
            shape = np.array([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
            slopes = np.array([t - 1, 1 - t, t, -t]), np.array([s - 1, -s, s, 1 - s])
            edges = slopes[0] @ nodes, slopes[1] @ nodes
            area = edges[0][:, 0] * edges[1][:, 1] - edges[0][:, 1] * edges[1][:, 0]
            x, y = (shape @ nodes).T
            yield _GaussPoint(along * across * area, x, y, shape, *slopes, edges, area)
