"""The L2 norm of an interpolation error on any mesh of triangles or quadrilaterals. Independent of the solver."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
Function: TypeAlias = Callable[[Array, Array], Array]

POINTS = 6


def l2_error(points: Array, cells: IntArray, u: Function, count: int = POINTS) -> float:
    """The L2 norm of u minus its interpolant at the vertices, linear on triangles and bilinear on quadrilaterals.

    ``points`` has shape ``(v, 2)``, ``cells`` ``(c, 3)`` or ``(c, 4)``, counter-clockwise; ``count`` Gauss points a
    direction. A triangle is a quadrilateral whose last two vertices coincide: the bilinear map is then Duffy's, and the
    interpolant linear.
    """
    corners = cells[:, [0, 1, 2, 2]] if cells.shape[1] == 3 else cells
    values, nodes, total = u(points[:, 0], points[:, 1])[corners], points[corners], 0.0
    places, weights = np.polynomial.legendre.leggauss(count)
    places, weights = 0.5 * (places + 1.0), 0.5 * weights
    for s, along in zip(places, weights, strict=True):
        for t, across in zip(places, weights, strict=True):
            shape = np.array([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
            by_s = np.array([t - 1, 1 - t, t, -t]) @ nodes
            by_t = np.array([s - 1, -s, s, 1 - s]) @ nodes
            area = by_s[:, 0] * by_t[:, 1] - by_s[:, 1] * by_t[:, 0]
            place = shape @ nodes
            error = values @ shape - u(place[:, 0], place[:, 1])
            total += along * across * float(area @ error**2)
    return math.sqrt(total)
