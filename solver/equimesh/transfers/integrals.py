"""The integrals that a conservative transfer keeps: of averages over cells, and of values at nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from equimesh.inputs import AT_PLACES, shaped_array
from equimesh.meshes.cell_edges import QuadLinks, links_of
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array, IntArray

# Areas, centroids and weights of the corners of straight-edged cells.


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


# The cells of a mesh, as a conservative transfer needs them.


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """Areas and centroids of the straight-edged cells of a mesh, and the weights of their corners; all flat.

    Nodes that a periodic join ties are one node here: ``(k,)`` is the shape of one value at each of these.
    """

    area: Array
    x: Array
    y: Array
    weights: Array
    """The integrals of the four bilinear functions of the corners over each cell, shape ``(cells, 4)``."""
    corners: Array
    """The coordinates of the corners, counter-clockwise, shape ``(2, cells, 4)``."""
    links: QuadLinks
    """The cells over the nodes, of which tied ones are one."""
    kept: IntArray
    """The node of the mesh for each node here."""
    number: IntArray
    """The node here for each node of the mesh."""

    @classmethod
    def of(cls, mesh: Mesh) -> Cells:
        """The cells of a valid mesh."""
        corners = np.stack([np.ravel(z)[mesh.cells] for z in (mesh.x, mesh.y)])
        area, x, y, weights = measures_of(corners)
        kept, number = untied(mesh)
        links = links_of(number[mesh.cells], kept.size)
        return cls(area=area, x=x, y=y, weights=weights, corners=corners, links=links, kept=kept, number=number)

    @property
    def shape(self) -> tuple[int]:
        """The shape of one value on each cell."""
        return (self.area.size,)

    @property
    def nodes(self) -> tuple[int]:
        """The shape of one value at each node."""
        return (self.kept.size,)

    def at_corners(self, nodal: Array) -> Array:
        """Nodal values at the corners of the cells, shape ``(cells, 4)``."""
        return nodal[self.links.cells]

    def at_nodes(self, of_corners: Array) -> Array:
        """The sums at the nodes of numbers of the corners, flat."""
        flat = np.asarray(of_corners, dtype=float).reshape(-1)
        return np.asarray(np.bincount(self.links.cells.reshape(-1), flat, minlength=self.kept.size), dtype=float)

    def around_nodes(self, of_cells: Array, extreme: np.ufunc) -> Array:
        """The least or largest number of the cells around each node."""
        found = np.full(self.kept.size, np.inf if extreme is np.minimum else -np.inf)
        extreme.at(found, self.links.cells.reshape(-1), np.repeat(of_cells, 4))
        return found

    @cached_property
    def node_weights(self) -> Array:
        """The integral of the bilinear function that is 1 at one node and 0 at the others, for each node."""
        return self.at_nodes(self.weights)


def untied(mesh: Mesh) -> tuple[IntArray, IntArray]:
    """The nodes that are left where tied ones are one, and the number among these for each node of the mesh."""
    first = np.arange(len(mesh.points))
    while len(mesh.ties):  # a corner that is joined both ways is a copy of a copy
        before = first.copy()
        np.minimum.at(first, mesh.ties[:, 0], first[mesh.ties[:, 1]])
        np.minimum.at(first, mesh.ties[:, 1], first[mesh.ties[:, 0]])
        if np.array_equal(first, before):
            break
    kept, number = np.unique(first, return_inverse=True)
    return kept, number.reshape(-1)


def integral(mesh: Mesh, values: npt.ArrayLike, location: Literal["nodes", "cells"] = "nodes") -> float:
    """The integral of values on a valid mesh, which a conservative transfer keeps.

    ``values`` are averages over the cells, or values at the nodes of a bilinear function, in the shapes
    ``mesh.cell_shape`` and ``mesh.node_shape``: ``(n_xi - 1, n_eta - 1)`` and ``(n_xi, n_eta)`` on a grid. Raises
    :class:`~equimesh.errors.SamplesError` for another shape.
    """
    wanted = mesh.node_shape if location == "nodes" else mesh.cell_shape
    checked = shaped_array(values, "values", wanted, AT_PLACES[location])
    cells, flat = Cells.of(mesh), checked.reshape(-1)
    return total(cells.node_weights, flat[cells.kept]) if location == "nodes" else total(cells.area, flat)


def total(weights: Array, values: Array) -> float:
    """The sum of products, free of the rounding of partial sums."""
    return math.fsum((weights * values).tolist())
