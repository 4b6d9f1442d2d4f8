"""The integrals that a conservative transfer keeps: of averages over cells, and of values at nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from equimesh.errors import SamplesError
from equimesh.inputs import real_array
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Areas and centroids of the straight-edged cells of a mesh, and the weights of their corners; all flat."""

    shape: tuple[int, int]
    """Cells along xi and eta."""
    area: Array
    x: Array
    y: Array
    weights: Array
    """The integrals of the four bilinear functions of the corners over each cell, shape ``(cells, 4)``."""
    corners: Array
    """The coordinates of the corners, counter-clockwise, shape ``(2, cells, 4)``."""

    @property
    def nodes(self) -> tuple[int, int]:
        """Nodes along xi and eta."""
        return self.shape[0] + 1, self.shape[1] + 1

    def at_corners(self, nodal: Array) -> Array:
        """Nodal values at the corners of the cells, shape ``(cells, 4)``."""
        return _corners(nodal.reshape(self.nodes)).reshape(-1, 4)

    def at_nodes(self, of_corners: Array) -> Array:
        """The sums at the nodes of numbers of the corners, flat."""
        total, parts = np.zeros(self.nodes), of_corners.reshape(*self.shape, 4)
        total[:-1, :-1] += parts[..., 0]
        total[1:, :-1] += parts[..., 1]
        total[1:, 1:] += parts[..., 2]
        total[:-1, 1:] += parts[..., 3]
        return total.reshape(-1)

    @property
    def node_weights(self) -> Array:
        """The integral of the bilinear function that is 1 at one node and 0 at the others, for each node, flat."""
        return self.at_nodes(self.weights)


def cells_of(mesh: Mesh) -> Cells:
    """The cells of a valid mesh.

    The integral of the bilinear function of a corner is ``area/6 + jacobian/12`` with the Jacobian of the corner: the
    mean of the integrals of the linear functions on the triangles of the two ways to cut the cell.
    """
    corners = np.stack([_corners(mesh.x).reshape(-1, 4), _corners(mesh.y).reshape(-1, 4)])
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
    return Cells(
        shape=(mesh.x.shape[0] - 1, mesh.x.shape[1] - 1),
        area=area,
        x=centroid[0],
        y=centroid[1],
        weights=area[:, None] / 6.0 + jacobians / 12.0,
        corners=corners,
    )


def integral(mesh: Mesh, values: npt.ArrayLike, location: Literal["nodes", "cells"] = "nodes") -> float:
    """The integral of values on a valid mesh, which a conservative transfer keeps.

    ``values`` are averages over the cells, shape ``(n_xi - 1, n_eta - 1)``, or values at the nodes, shape
    ``(n_xi, n_eta)``, of a bilinear function. Raises :class:`~equimesh.errors.SamplesError` for another shape.
    """
    checked, cells = real_array(values, "values", ndim=2), cells_of(mesh)
    wanted = cells.nodes if location == "nodes" else cells.shape
    if checked.shape != wanted:
        raise SamplesError(f"values have shape {checked.shape}: {wanted} is needed for {location}", field="values")
    return total(cells.node_weights if location == "nodes" else cells.area, checked.reshape(-1))


def total(weights: Array, values: Array) -> float:
    """The sum of products, free of the rounding of partial sums."""
    return math.fsum((weights * values).tolist())


def _corners(nodal: Array) -> Array:
    """Values at the corners of the cells, counter-clockwise, shape ``(n_xi - 1, n_eta - 1, 4)``."""
    return np.stack([nodal[:-1, :-1], nodal[1:, :-1], nodal[1:, 1:], nodal[:-1, 1:]], axis=-1)
