"""Areas, centroids and weights of the corners of straight-edged cells."""

from typing import NamedTuple

import numpy as np

from equimesh.numerics.types import Array


class Measures(NamedTuple):
    """Areas and centres of quadrilaterals, flat."""

    area: Array
    x: Array
    """The centroids."""
    y: Array
    weights: Array
    """The integrals of the four bilinear functions of the corners over each cell, shape ``(cells, 4)``."""


def measures_of(corners: Array) -> Measures:
    """The measures of valid cells with ``corners`` of shape ``(2, cells, 4)``, counter-clockwise.

    The integral of the bilinear function of a corner is ``area/6 + jacobian/12`` with the Jacobian of the corner: the
    mean of the integrals of the linear functions on the triangles of the two ways to cut the cell.
    """
    x, y = corners
    dx, dy = np.roll(x, -1, axis=1) - x, np.roll(y, -1, axis=1) - y
    jacobians = np.roll(dx, 1, axis=1) * dy - np.roll(dy, 1, axis=1) * dx
    area = 0.25 * jacobians.sum(axis=1)
    # The centroid of the two triangles that meet in the diagonal of the first corner.
    one, other = jacobians[:, 1] / (2.0 * area), jacobians[:, 3] / (2.0 * area)
    centroid = [
        z[:, 0] + (one * (z[:, 1] + z[:, 2] - 2 * z[:, 0]) + other * (z[:, 2] + z[:, 3] - 2 * z[:, 0])) / 3.0
        for z in (x, y)
    ]
    return Measures(area, centroid[0], centroid[1], area[:, None] / 6.0 + jacobians / 12.0)
