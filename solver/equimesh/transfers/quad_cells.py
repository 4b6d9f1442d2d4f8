"""The cells of a mesh of quadrilaterals, as a conservative transfer needs them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from equimesh.meshes.quad_links import QuadLinks, links_of
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array, IntArray
from equimesh.transfers.measures import measures_of


@dataclass(frozen=True, kw_only=True, eq=False)
class QuadCells:
    """As :class:`~equimesh.transfers.integrals.Cells`, of a mesh whose cells have one number each.

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
    def of(cls, mesh: QuadMesh) -> QuadCells:
        """The cells of a valid mesh."""
        corners = np.stack([mesh.x[mesh.cells], mesh.y[mesh.cells]])
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


def untied(mesh: QuadMesh) -> tuple[IntArray, IntArray]:
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
