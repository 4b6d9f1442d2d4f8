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
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.transfers.measures import measures_of
from equimesh.transfers.quad_cells import QuadCells


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

    def around_nodes(self, of_cells: Array, extreme: np.ufunc) -> Array:
        """The least or largest number of the cells around each node."""
        padded = np.pad(of_cells.reshape(self.shape), 1, mode="edge")
        along = extreme(padded[1:], padded[:-1])
        found: Array = extreme(along[:, 1:], along[:, :-1])
        return found

    @property
    def node_weights(self) -> Array:
        """The integral of the bilinear function that is 1 at one node and 0 at the others, for each node, flat."""
        return self.at_nodes(self.weights)


def cells_of(mesh: Mesh) -> Cells:
    """The cells of a valid mesh."""
    corners = np.stack([_corners(mesh.x).reshape(-1, 4), _corners(mesh.y).reshape(-1, 4)])
    area, x, y, weights = measures_of(corners)
    shape = (mesh.x.shape[0] - 1, mesh.x.shape[1] - 1)
    return Cells(shape=shape, area=area, x=x, y=y, weights=weights, corners=corners)


def integral(mesh: Mesh | QuadMesh, values: npt.ArrayLike, location: Literal["nodes", "cells"] = "nodes") -> float:
    """The integral of values on a valid mesh, which a conservative transfer keeps.

    ``values`` are averages over the cells, or values at the nodes of a bilinear function, in the shapes
    ``mesh.cell_shape`` and ``mesh.node_shape``: ``(n_xi - 1, n_eta - 1)`` and ``(n_xi, n_eta)`` on a grid. Raises
    :class:`~equimesh.errors.SamplesError` for another shape.
    """
    checked = real_array(values, "values", ndim=len(mesh.node_shape))
    wanted = mesh.node_shape if location == "nodes" else mesh.cell_shape
    if checked.shape != wanted:
        raise SamplesError(f"values have shape {checked.shape}: {wanted} is needed for {location}", field="values")
    if isinstance(mesh, QuadMesh):
        of_quads = QuadCells.of(mesh)
        if location == "nodes":
            return total(of_quads.node_weights, checked[of_quads.kept])
        return total(of_quads.area, checked)
    cells = cells_of(mesh)
    return total(cells.node_weights if location == "nodes" else cells.area, checked.reshape(-1))


def total(weights: Array, values: Array) -> float:
    """The sum of products, free of the rounding of partial sums."""
    return math.fsum((weights * values).tolist())


def _corners(nodal: Array) -> Array:
    """Values at the corners of the cells, counter-clockwise, shape ``(n_xi - 1, n_eta - 1, 4)``."""
    return np.stack([nodal[:-1, :-1], nodal[1:, :-1], nodal[1:, 1:], nodal[:-1, 1:]], axis=-1)
