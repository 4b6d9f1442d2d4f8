"""Meshes of quadrilaterals: grids and meshes of any topology, and the rows of a grid that are here."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeAlias, overload

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.cell_edges import Connected, Join, cells_of_blocks, check_table, joins_of, no_ties
from equimesh.meshes.rows import Rows
from equimesh.numerics.compiled import compiled
from equimesh.numerics.threads import run_on_threads
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import Cells, MeshParts, quads_of
from equimesh_schema.document import hinted, is_whole

# The computational domain: a uniform grid of points on the unit square.

MIN_POINTS = 4  # in each direction
IN_ALL = "for so many points in all give Target(max_points=...) to solve_to"
"""What to give in place of points of a grid."""


@hinted(points=IN_ALL)
@dataclass(frozen=True)
class Grid:
    """``n_xi`` x ``n_eta`` uniformly spaced **points** on the computational unit square.

    ``Grid(33)`` has 33 in both directions.

    A "12 by 12 mesh" of the paper has 12 points a side, hence 11 x 11 cells.

    Raises :class:`~equimesh.errors.InputError` for no whole number, or fewer than 4 points in a direction.
    """

    n_xi: int
    n_eta: int = None  # type: ignore[assignment] # as many as n_xi

    def __post_init__(self) -> None:
        if self.n_eta is None:
            object.__setattr__(self, "n_eta", self.n_xi)  # type: ignore[unreachable]
        for name in ("n_xi", "n_eta"):
            count = getattr(self, name)
            if not is_whole(count):
                raise InputError(f"{name} = {count!r:.40}: give a whole number of points", field=f"grid.{name}")
            if count < MIN_POINTS:
                raise InputError(
                    f"{name} = {count}: a grid needs at least {MIN_POINTS} points in each direction",
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
    least, total = np.inf, 0.0
    for j in range(n_eta - 1):
        least, total = min(least, smallest[j]), total + check[j]
    return least if np.isfinite(total) else np.nan


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
    most = 0.0
    for here in largest:
        most = max(most, here)
    return most if np.isfinite(check) else np.nan


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
# Fewer cells are not worth a second thread.
MIN_SHARED_CELLS = 16_384


ComparedWith: TypeAlias = Literal["uniform", "initial"]
"""The mesh with which others are compared: the uniform one of a grid, or the one that blocks begin with."""


@dataclass(frozen=True, eq=False, init=False)
class Mesh(Coupled):
    """A mesh of quadrilaterals: a grid of rows, made of ``x`` and ``y``, or one of any topology, made of ``points``.

    - ``x``, ``y``: coordinates of the nodes of a grid, shape ``(n_xi, n_eta)``, the first index running along xi. Node
      ``(i, j)`` has number ``i * n_eta + j``, cell ``(i, j)`` number ``i * (n_eta - 1) + j``. A grid is a mesh of one
      block with the sides ``left``, ``right``, ``bottom`` and ``top``; it needs nothing else.
    - ``points``: coordinates of the nodes of any other mesh, shape ``(n, 2)``; ``x`` and ``y`` are its columns.
    - ``cells``: nodes of every cell, counter-clockwise, shape ``(m, 4)``: block by block, or in the order of the file
      that the mesh was read from.
    - ``sides``: boundary edges by the name of their side, shape ``(k, 2)`` each, with the domain on their left, in
      their order along the side.
    - ``blocks``: for each block the numbers of its nodes, shape ``(n_i, n_j)``. Where i runs to the right, j runs
      upwards. Blocks that touch have the numbers of their common nodes in common.
    - ``block_names``: a name for each block.
    - ``ties``: pairs of nodes that are one unknown, shape ``(k, 2)``: a copy and its original, which lie apart by the
      translation of a periodic join, or are the two copies of a node on a seam. Empty where nothing is joined.

    One value at each node has the shape ``node_shape``, one on each cell ``cell_shape``: rows and columns on a grid,
    ``(n,)`` and ``(m,)`` on any other mesh.

    Raises :class:`~equimesh.errors.InputError` for arrays of other shapes, and for numbers that are no nodes.
    """

    x: Array
    y: Array
    _points: Array | None = field(repr=False)
    _connected: Connected | None = field(repr=False)
    _ties: IntArray | None = field(repr=False)

    @overload
    def __init__(self, x: Array, y: Array, *, ties: IntArray | None = None) -> None: ...
    @overload
    def __init__(
        self,
        *,
        points: Array,
        cells: IntArray,
        sides: Mapping[str, IntArray],
        blocks: tuple[IntArray, ...] = (),
        block_names: tuple[str, ...] = (),
        ties: IntArray | None = None,
    ) -> None: ...
    def __init__(
        self,
        x: Array | None = None,
        y: Array | None = None,
        *,
        points: Array | None = None,
        cells: IntArray | None = None,
        sides: Mapping[str, IntArray] | None = None,
        blocks: tuple[IntArray, ...] = (),
        block_names: tuple[str, ...] = (),
        ties: IntArray | None = None,
    ) -> None:
        own = vars(self)
        if x is not None and y is not None and points is None:
            if x.shape != y.shape or x.ndim != 2:
                raise InputError(f"x and y need one common shape (n_xi, n_eta), not {x.shape} and {y.shape}")
            if ties is not None:
                check_table(ties, "ties", 2, x.size)
            own.update(x=x, y=y, _points=None, _connected=None, _ties=ties)
            return
        if x is not None or y is not None or points is None or cells is None or sides is None:
            raise InputError("give x and y of a grid, or points, cells and sides of any other mesh", field="points")
        found = Connected.of(points, cells, sides, blocks, block_names, no_ties() if ties is None else ties)
        own.update(x=points[:, 0], y=points[:, 1], _points=points, _connected=found, _ties=found.ties)

    def __getstate__(self) -> dict[str, Any]:
        """What the mesh was made of, for pickle: cells of blocks are found anew."""
        kept = {name: vars(self)[name] for name in ("_points", "_connected", "_ties")}
        return kept if self._points is not None else {**kept, "x": self.x, "y": self.y}

    def __setstate__(self, state: dict[str, Any]) -> None:
        points = state["_points"]
        vars(self).update(state if points is None else {**state, "x": points[:, 0], "y": points[:, 1]})

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
        """The same mesh with its nodes at other ``points``, shape ``(n, 2)``."""
        if points.shape != (self.x.size, 2):
            raise InputError(f"points has shape {points.shape}, this mesh needs {(self.x.size, 2)}", field="points")
        if self.is_grid:
            x, y = (np.ascontiguousarray(q).reshape(self.x.shape) for q in points.T)
            return Mesh(x, y, ties=self._ties)
        moved = object.__new__(type(self))  # numbers that have been checked need not be checked again
        vars(moved).update(vars(self) | {"x": points[:, 0], "y": points[:, 1], "_points": points})
        return moved

    @property
    def is_grid(self) -> bool:
        """Whether the nodes are in rows and columns: values at the nodes have the shape ``(n_xi, n_eta)``."""
        return self._connected is None

    @property
    def grid(self) -> Grid:
        """The computational grid that the nodes belong to.

        Raises :class:`~equimesh.errors.InputError` for a mesh that is no grid.
        """
        if not self.is_grid:
            raise InputError("this needs a grid, and a mesh of blocks has no rows and columns", field="mesh")
        return Grid(n_xi=self.x.shape[0], n_eta=self.x.shape[1])

    @property
    def shape(self) -> tuple[int, int] | None:
        """``(n_xi, n_eta)`` of a grid; ``None`` for any other mesh."""
        return (self.x.shape[0], self.x.shape[1]) if self.is_grid else None

    @property
    def compared_with(self) -> ComparedWith:
        """The name of the mesh with which others on the same domain are compared."""
        return "uniform" if self.is_grid else "initial"

    @property
    def node_shape(self) -> tuple[int, ...]:
        """The shape of one value at each node: ``(n_xi, n_eta)`` of a grid, else ``(n,)``."""
        return self.x.shape

    @property
    def cell_shape(self) -> tuple[int, ...]:
        """The shape of one value on each cell: ``(n_xi - 1, n_eta - 1)`` of a grid, else ``(m,)``."""
        if self._connected is None:
            return self.x.shape[0] - 1, self.x.shape[1] - 1
        return (len(self._connected.cells),)

    @property
    def points(self) -> Array:
        """Node coordinates, shape ``(n, 2)``."""
        return np.column_stack([self.x.ravel(), self.y.ravel()]) if self._points is None else self._points

    @property
    def cells(self) -> IntArray:
        """Nodes of every quadrilateral, counter-clockwise, shape ``(m, 4)``."""
        return quads_of((self.x.shape[0], self.x.shape[1])) if self._connected is None else self._connected.cells

    @property
    def sides(self) -> Mapping[str, IntArray]:
        """Boundary edges by the name of their side, shape ``(k, 2)`` each, the domain on their left."""
        if self._connected is not None:
            return self._connected.sides
        number = np.arange(self.x.size).reshape(self.x.shape)
        lines = {"left": number[0, ::-1], "right": number[-1, :], "bottom": number[:, 0], "top": number[::-1, -1]}
        return {side: np.column_stack([lines[side][:-1], lines[side][1:]]) for side in SIDES}

    @property
    def blocks(self) -> tuple[IntArray, ...]:
        """For each block the numbers of its nodes, shape ``(n_i, n_j)``; a grid is one block."""
        if self._connected is not None:
            return self._connected.blocks
        return (np.arange(self.x.size).reshape(self.x.shape),)

    @property
    def block_names(self) -> tuple[str, ...]:
        """A name for each block."""
        return ("grid",) if self._connected is None else self._connected.block_names

    @property
    def ties(self) -> IntArray:
        """Pairs of nodes that are one, shape ``(k, 2)``: a copy, and its original."""
        return no_ties() if self._ties is None else self._ties

    @property
    def periodic(self) -> tuple[Join, ...]:
        """The pairs of sides that are joined by a translation, with their ``nodes``; none where nothing is joined.

        Raises :class:`~equimesh.errors.InputError` where a side is joined in part, to several sides, or to itself.
        """
        return joins_of(self.points, self.sides, self.ties)

    @cached_property
    def block_cells(self) -> tuple[IntArray, ...]:
        """For each block the numbers of its cells, shape ``(n_i - 1, n_j - 1)``.

        Raises :class:`~equimesh.errors.InputError` where a block has a cell that the mesh does not have.
        """
        if self._connected is None:
            return (np.arange(math.prod(self.cell_shape)).reshape(self.cell_shape),)
        return cells_of_blocks(self._connected.blocks, self._connected.cells)

    def block_mesh(self, k: int) -> Mesh:
        """Block ``k`` as a grid of its own."""
        block = self.blocks[k]
        return Mesh(self.x.reshape(-1)[block], self.y.reshape(-1)[block])

    def triangles(self) -> IntArray:
        """The cells cut into triangles, counter-clockwise, shape ``(2 m, 3)``.

        Cell ``k`` gives the rows ``2 k`` and ``2 k + 1``. Each quadrilateral is cut along the diagonal that leaves the
        larger smallest angle. A cell with two boundary edges that meet, as at the corners of a grid, is cut through
        their corner, so that no triangle has two edges on the boundary.
        """
        return self.mesh_parts("triangle").cells

    def mesh_parts(self, cells: Cells | None = None) -> MeshParts:
        """Points, cells and sides as plain arrays; quadrilaterals, unless ``cells`` is ``"triangle"``.

        Raises :class:`~equimesh_coupling.BadValues` for another kind of cells.
        """
        parts = MeshParts(points=self.points, cells=self.cells, sides=self.sides, shape=self.shape)
        return parts.mesh_parts(cells)

    def distance(self, other: Mesh) -> float:
        """The largest difference of a coordinate to another mesh of the same nodes."""
        if self._points is not None:
            return float(largest_difference(self._points, other.points))
        return max(largest_difference(self.x, other.x), largest_difference(self.y, other.y))

    def cell_areas(self) -> Array:
        """The area of every cell, of the ``cell_shape``; negative if inverted."""
        points, cells = self.points, self.cells
        a, b, c, d = (points[cells[:, k]] for k in range(4))
        one, other = c - a, d - b
        return np.asarray(0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])).reshape(self.cell_shape)

    def corner_jacobians(self) -> Array:
        """Jacobian of the cell map at the corners of the cells, shape ``(4, *cell_shape)``, counter-clockwise.

        The cross product of the two edges at the corner. On a grid it is scaled by the spacing: the uniform mesh of the
        unit square has 1 everywhere, a mesh of a domain of area A about A in the mean. On any other mesh it is divided
        by the mean area of cells. A bilinear cell is valid (its map one to one) exactly when all four are positive.
        """
        at = self.points[self.cells]
        ahead, behind = np.roll(at, -1, axis=1) - at, np.roll(at, 1, axis=1) - at
        cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
        return self._scaled(cross.T.reshape(4, *self.cell_shape))

    def _scaled(self, jacobians: Array) -> Array:
        """Corner Jacobians times the number of cells of a grid, else over the mean area of cells."""
        scaled = jacobians * math.prod(self.cell_shape) if self.is_grid else jacobians / self.cell_areas().mean()
        return np.asarray(scaled)

    @property
    def min_jacobian(self) -> float:
        """The smallest of :meth:`corner_jacobians`; not positive for a folded mesh."""
        smallest = self._smallest(1)
        return smallest * math.prod(self.cell_shape) if self.is_grid else float(smallest / self.cell_areas().mean())

    @property
    def is_folded(self) -> bool:
        """Whether some cell is inverted, degenerate, or has a coordinate that is not finite."""
        return self.is_folded_on(1)

    def is_folded_on(self, threads: int) -> bool:
        """Whether a cell is folded, as :attr:`is_folded`; the ``threads`` share the cells."""
        return not self._smallest(threads) > 0.0

    def _smallest(self, threads: int) -> float:
        """The smallest corner Jacobian, not scaled; NaN where a coordinate is not a number."""
        if self._points is None or self._connected is None:
            if threads == 1:
                return smallest_jacobian(self.x, self.y)
            return smallest_of_rows(self.x, self.y, Rows.whole(self.x.shape, threads))
        points, cells = self._points, self._connected.cells
        count = max(1, min(threads, len(cells) // MIN_SHARED_CELLS))
        ends = np.linspace(0, len(cells), count + 1).astype(np.int64)
        smallest = np.full(count, np.nan)

        def work(k: int) -> None:
            smallest[k] = smallest_of_cells(points, cells[ends[k] : ends[k + 1]])

        run_on_threads(count, work)
        return float(smallest.min())


@dataclass(frozen=True, eq=False)
class MeshRows:
    """Nodes ``x`` and ``y`` of the ``rows`` of a mesh that are here, C-contiguous, of the shape ``rows.here_shape``.

    Rows of cells are measured where they are. Around the own ones stand rows of nodes of their neighbours, since some
    measures compare a cell with the next one.
    """

    x: Array
    y: Array
    rows: Rows
    is_grid: ClassVar[bool] = True
    """Rows are those of a grid."""

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
        x, y = np.empty((2, *rows.here_shape))
        x[:], y[:] = np.linspace(0.0, 1.0, rows.shape[0])[rows.here, None], np.linspace(0.0, 1.0, rows.shape[1])
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
