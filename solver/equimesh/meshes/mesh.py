"""Structured quadrilateral meshes on a uniform grid, and the rows of such a mesh that are here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.rows import Rows
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import Cells, MeshParts, quads_of, triangles_of

# The computational domain: a uniform grid of points on the unit square.

MIN_POINTS = 4  # in each direction


@dataclass(frozen=True)
class Grid:
    """``n_xi`` x ``n_eta`` uniformly spaced **points** on the computational unit square.

    ``Grid(33)`` has 33 in both directions.

    A "12 by 12 mesh" of the paper has 12 points a side, hence 11 x 11 cells.

    Raises :class:`~equimesh.errors.InputError` for fewer than 4 points in a direction.
    """

    n_xi: int
    n_eta: int = None  # type: ignore[assignment] # as many as n_xi

    def __post_init__(self) -> None:
        if self.n_eta is None:
            object.__setattr__(self, "n_eta", self.n_xi)  # type: ignore[unreachable]
        for name in ("n_xi", "n_eta"):
            if getattr(self, name) < MIN_POINTS:
                raise InputError(
                    f"{name} = {getattr(self, name)}: a grid needs at least {MIN_POINTS} points in each direction",
                    field=f"grid.{name}",
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of every nodal array, xi first."""
        return (self.n_xi, self.n_eta)

    @property
    def points(self) -> int:
        """Number of grid points."""
        return self.n_xi * self.n_eta

    @property
    def cells(self) -> int:
        """Number of cells."""
        return (self.n_xi - 1) * (self.n_eta - 1)

    @property
    def d_xi(self) -> float:
        """Spacing in xi."""
        return 1.0 / (self.n_xi - 1)

    @property
    def d_eta(self) -> float:
        """Spacing in eta."""
        return 1.0 / (self.n_eta - 1)

    def __str__(self) -> str:
        return f"{self.n_xi} x {self.n_eta}"


# Loops over nodal values: the smallest corner Jacobian, which shows whether a mesh is folded, and differences.


def smallest_of_rows(x: Array, y: Array, rows: Rows) -> float:
    """:func:`smallest_jacobian` of the whole mesh, of which ``x`` and ``y`` have the ``rows`` that are here."""
    return -rows.agreed(-smallest_here(x, y, rows))[0]


def smallest_here(x: Array, y: Array, rows: Rows) -> float:
    """:func:`smallest_jacobian` of the own cells; each thread finds that of its share."""
    if len(rows.shares) == 1:
        return smallest_jacobian(x[rows.shares[0].rows_and_next], y[rows.shares[0].rows_and_next])
    return -rows.largest_here(lambda share: -smallest_jacobian(x[share.rows_and_next], y[share.rows_and_next]))


@compiled
def smallest_jacobian(x: Array, y: Array) -> float:
    """The smallest corner Jacobian of a mesh, not scaled by the spacing; NaN where a coordinate is not a number."""
    n_xi, n_eta = x.shape
    # By columns, so that the compiler can use vector instructions. Minima ignore NaN, sums do not.
    smallest, check = np.full(n_eta - 1, np.inf), np.zeros(n_eta - 1)
    for i in range(n_xi - 1):
        x0, x1, y0, y1 = x[i], x[i + 1], y[i], y[i + 1]
        for j in range(n_eta - 1):
            ex0, ey0 = x1[j] - x0[j], y1[j] - y0[j]
            ex1, ey1 = x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
            fx0, fy0 = x0[j + 1] - x0[j], y0[j + 1] - y0[j]
            fx1, fy1 = x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            one, two = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
            three, four = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
            here = min(min(one, two), min(three, four))
            smallest[j] = min(smallest[j], here)
            check[j] += one + two + three + four
    return smallest.min() if np.isfinite(check.sum()) else np.nan


@compiled
def largest_difference(one: Array, other: Array) -> float:
    """The largest absolute difference of nodal values; NaN where one is not a number."""
    rows, columns = one.shape
    largest, check = np.zeros(columns), 0.0
    for i in range(rows):
        a, b = one[i], other[i]
        for j in range(columns):
            difference = abs(a[j] - b[j])
            largest[j] = max(largest[j], difference)
            check += difference
    return largest.max() if np.isfinite(check) else np.nan


@compiled
def smallest_of_cells(points: Array, cells: IntArray) -> float:
    """The smallest corner Jacobian of quadrilaterals of any mesh; NaN where a coordinate is not a number."""
    smallest, check = np.inf, 0.0
    for k in range(len(cells)):
        a, b, c, d = cells[k]
        xa, ya, xb, yb = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
        xc, yc, xd, yd = points[c, 0], points[c, 1], points[d, 0], points[d, 1]
        at_a = (xb - xa) * (yd - ya) - (yb - ya) * (xd - xa)
        at_b = (xc - xb) * (ya - yb) - (yc - yb) * (xa - xb)
        at_c = (xd - xc) * (yb - yc) - (yd - yc) * (xb - xc)
        at_d = (xa - xd) * (yc - yd) - (ya - yd) * (xc - xd)
        smallest = min(smallest, min(min(at_a, at_b), min(at_c, at_d)))
        check += at_a + at_b + at_c + at_d
    return smallest if np.isfinite(check) else np.nan


SIDES = ("left", "right", "bottom", "top")


ComparedWith: TypeAlias = Literal["uniform", "initial"]
"""The mesh with which others are compared: the uniform one of a grid, or the one that blocks begin with."""


@dataclass(frozen=True, eq=False)
class Mesh(Coupled):
    """Node coordinates ``x`` and ``y`` of shape ``(n_xi, n_eta)``, the first index running along xi.

    Node ``(i, j)`` has number ``i * n_eta + j``, cell ``(i, j)`` number ``i * (n_eta - 1) + j``.
    """

    x: Array
    y: Array
    compared_with: ClassVar[ComparedWith] = "uniform"
    """The name of the mesh with which others on the same domain are compared."""

    def __post_init__(self) -> None:
        if self.x.shape != self.y.shape or self.x.ndim != 2:
            raise InputError(f"x and y need one common shape (n_xi, n_eta), not {self.x.shape} and {self.y.shape}")

    @classmethod
    def uniform(cls, grid: Grid) -> Mesh:
        """The mesh whose nodes are the grid points themselves."""
        x, y = np.empty(grid.shape), np.empty(grid.shape)
        x[:], y[:] = np.linspace(0, 1, grid.n_xi)[:, None], np.linspace(0, 1, grid.n_eta)
        return cls(x, y)

    @classmethod
    def of_unit_square(cls, x: Array, y: Array) -> Mesh:
        """A mesh whose sides lie on those of the unit square exactly, free of the rounding errors of a solve."""
        x, y = x.copy(), y.copy()
        x[0], x[-1], y[:, 0], y[:, -1] = 0.0, 1.0, 0.0, 1.0
        return cls(x, y)

    def moved(self, points: Array) -> Mesh:
        """The same mesh with its nodes at other ``points``, shape ``(n_xi * n_eta, 2)``."""
        x, y = (np.ascontiguousarray(q).reshape(self.x.shape) for q in points.T)
        return Mesh(x, y)

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
        return not smallest_of_rows(self.x, self.y, Rows.whole(self.x.shape, threads)) > 0.0


@dataclass(frozen=True, eq=False)
class MeshRows:
    """Nodes ``x`` and ``y`` of the ``rows`` of a mesh that are here, C-contiguous, of the shape ``rows.here_shape``.

    Rows of cells are measured where they are. Around the own ones stand rows of nodes of their neighbours, since some
    measures compare a cell with the next one.
    """

    x: Array
    y: Array
    rows: Rows

    @classmethod
    def of(cls, mesh: Mesh | MeshRows, threads: int = 1) -> MeshRows:
        """All rows of a mesh, shared by so many threads; rows of a mesh as they are."""
        if isinstance(mesh, MeshRows):
            return mesh
        x, y = (np.ascontiguousarray(q, dtype=float) for q in (mesh.x, mesh.y))
        return cls(x, y, Rows.whole(x.shape, threads))

    @classmethod
    def uniform(cls, rows: Rows) -> MeshRows:
        """The uniform mesh of the unit square."""
        s, t = (np.linspace(0.0, 1.0, n) for n in rows.shape)
        x, y = np.meshgrid(s[rows.here], t, indexing="ij")
        return cls(x, y, rows)

    @property
    def grid(self) -> Grid:
        """The grid of the whole mesh."""
        return Grid(n_xi=self.rows.shape[0], n_eta=self.rows.shape[1])

    @property
    def min_jacobian(self) -> float:
        """The smallest corner Jacobian of the whole mesh, see :attr:`~equimesh.meshes.mesh.Mesh.min_jacobian`."""
        rows = self.rows
        here = [smallest_jacobian(*self.nodes(rows.first, rows.last))] if rows.first < rows.last else []
        return float(rows.joined(np.array(here)).min() * (rows.cells[0] * rows.cells[1]))

    @property
    def is_folded(self) -> bool:
        """Whether a cell of the whole mesh is folded, see :attr:`~equimesh.meshes.mesh.Mesh.is_folded`."""
        return not smallest_of_rows(self.x, self.y, self.rows) > 0.0

    def within(self, begin: int, end: int) -> MeshRows:
        """The rows ``begin`` to ``end - 1`` of these, in the same memory."""
        rows = slice(begin - self.rows.begin, end - self.rows.begin)
        return MeshRows(self.x[rows], self.y[rows], self.rows.within(begin, end))

    def nodes(self, first: int, last: int) -> tuple[Array, Array]:
        """x and y around the rows ``first`` to ``last - 1`` of cells, counted from the first row of the grid."""
        here = slice(first - self.rows.begin, last + 1 - self.rows.begin)
        return self.x[here], self.y[here]

    def strips(self) -> Iterator[tuple[Array, Array]]:
        """x and y around the cells of every strip of own rows."""
        return (self.nodes(first, last) for first, last in self.rows.strips)
