"""A structured quadrilateral mesh: node coordinates, and properties of geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.folding import largest_difference, smallest_in_parts, smallest_jacobian
from equimesh.meshes.grid import Grid
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import Cells, MeshParts, quads_of, triangles_of

SIDES = ("left", "right", "bottom", "top")


@dataclass(frozen=True, eq=False)
class Mesh(Coupled):
    """Node coordinates ``x`` and ``y`` of shape ``(n_xi, n_eta)``, the first index running along xi.

    Node ``(i, j)`` has number ``i * n_eta + j``, cell ``(i, j)`` number ``i * (n_eta - 1) + j``.
    """

    x: Array
    y: Array

    def __post_init__(self) -> None:
        if self.x.shape != self.y.shape or self.x.ndim != 2:
            raise InputError(f"x and y need one common shape (n_xi, n_eta), not {self.x.shape} and {self.y.shape}")

    @classmethod
    def uniform(cls, grid: Grid) -> Mesh:
        """The mesh whose nodes are the grid points themselves."""
        x, y = np.meshgrid(np.linspace(0, 1, grid.n_xi), np.linspace(0, 1, grid.n_eta), indexing="ij")
        return cls(x, y)

    @classmethod
    def of_unit_square(cls, x: Array, y: Array) -> Mesh:
        """A mesh whose sides lie on those of the unit square exactly, free of the rounding errors of a solve."""
        x, y = x.copy(), y.copy()
        x[0], x[-1], y[:, 0], y[:, -1] = 0.0, 1.0, 0.0, 1.0
        return cls(x, y)

    @property
    def grid(self) -> Grid:
        """The computational grid that the nodes belong to."""
        return Grid(n_xi=self.x.shape[0], n_eta=self.x.shape[1])

    @property
    def node_shape(self) -> tuple[int, int]:
        """The shape of one value at each node: ``(n_xi, n_eta)``."""
        return self.x.shape[0], self.x.shape[1]

    @property
    def cell_shape(self) -> tuple[int, int]:
        """The shape of one value on each cell: ``(n_xi - 1, n_eta - 1)``."""
        return self.x.shape[0] - 1, self.x.shape[1] - 1

    @property
    def points(self) -> Array:
        """Node coordinates, shape ``(n_xi * n_eta, 2)``."""
        return np.column_stack([self.x.ravel(), self.y.ravel()])

    @property
    def cells(self) -> npt.NDArray[np.int64]:
        """Nodes of every quadrilateral, counter-clockwise, shape ``((n_xi - 1) * (n_eta - 1), 4)``."""
        return quads_of((self.x.shape[0], self.x.shape[1]))

    @property
    def sides(self) -> dict[str, npt.NDArray[np.int64]]:
        """Boundary edges of the four named sides, shape ``(k, 2)`` each, the domain on their left."""
        number = np.arange(self.x.size).reshape(self.x.shape)
        lines = {"left": number[0, ::-1], "right": number[-1, :], "bottom": number[:, 0], "top": number[::-1, -1]}
        return {side: np.column_stack([lines[side][:-1], lines[side][1:]]) for side in SIDES}

    def triangles(self) -> IntArray:
        """The cells cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

        Cell ``k`` gives the rows ``2 k`` and ``2 k + 1``. Each quadrilateral is cut along the diagonal that leaves the
        larger smallest angle; those at the four corners are cut through the corner, so that no triangle has two edges
        on the boundary.
        """
        return triangles_of(self.points, (self.x.shape[0], self.x.shape[1]))

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """Points, cells and sides as plain arrays; quadrilaterals, unless ``cells`` is ``"triangle"``.

        Raises :class:`~equimesh_coupling.BadValues` for another kind of cells.
        """
        shape = (self.x.shape[0], self.x.shape[1])
        return MeshParts(points=self.points, cells=self.cells, sides=self.sides, shape=shape).mesh_parts(cells)

    def distance(self, other: Mesh) -> float:
        """The largest difference of a coordinate to another mesh of the same shape."""
        return max(largest_difference(self.x, other.x), largest_difference(self.y, other.y))

    def corner_jacobians(self) -> Array:
        """Jacobian of the cell map at the corners, shape ``(4, n_xi - 1, n_eta - 1)``, counter-clockwise.

        Scaled by the spacing of the grid: the uniform mesh of the unit square has 1 everywhere, a mesh of a domain of
        area A about A in the mean. A bilinear cell is valid (its map one to one) exactly when all four are positive.
        """
        x, y = self.x, self.y
        ex, ey = np.diff(x, axis=0), np.diff(y, axis=0)  # edges along xi, at each eta
        fx, fy = np.diff(x, axis=1), np.diff(y, axis=1)  # edges along eta, at each xi
        jacobians = np.stack(
            [
                ex[:, :-1] * fy[:-1] - ey[:, :-1] * fx[:-1],
                ex[:, :-1] * fy[1:] - ey[:, :-1] * fx[1:],
                ex[:, 1:] * fy[1:] - ey[:, 1:] * fx[1:],
                ex[:, 1:] * fy[:-1] - ey[:, 1:] * fx[:-1],
            ]
        )
        return np.asarray(jacobians * ((x.shape[0] - 1) * (x.shape[1] - 1)))

    @property
    def min_jacobian(self) -> float:
        """The smallest corner Jacobian; 1 for the uniform mesh of the unit square, not positive for a folded mesh."""
        n_xi, n_eta = self.x.shape
        return float(smallest_jacobian(self.x, self.y) * ((n_xi - 1) * (n_eta - 1)))

    @property
    def is_folded(self) -> bool:
        """Whether some cell is inverted, degenerate, or has a coordinate that is not finite."""
        return self.is_folded_on(1)

    def is_folded_on(self, threads: int) -> bool:
        """Whether a cell is folded, as :attr:`is_folded`; the ``threads`` share the cells."""
        return not smallest_in_parts(self.x, self.y, Parts.of(self.x.shape, threads)) > 0.0
