"""Structured quadrilateral meshes on a uniform grid, and the rows of such a mesh that are here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from equimesh.errors import InputError
from equimesh.meshes.parts import Parts, row_cuts
from equimesh.numerics.channel import ALONE, Channel, joined, summed
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.coupled import Coupled
from equimesh_coupling.parts import Cells, MeshParts, quads_of, triangles_of

# The computational domain: a uniform grid of points on the unit square.

MIN_POINTS = 4  # in each direction


@dataclass(frozen=True, kw_only=True)
class Grid:
    """``n_xi`` x ``n_eta`` uniformly spaced **points** on the computational unit square.

    A "12 by 12 mesh" of the paper has 12 points a side, hence 11 x 11 cells.

    Raises :class:`~equimesh.errors.InputError` for fewer than 4 points in a direction.
    """

    n_xi: int
    n_eta: int

    def __post_init__(self) -> None:
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


def smallest_in_parts(x: Array, y: Array, parts: Parts) -> float:
    """:func:`smallest_jacobian`, to which every part contributes that of its own cells."""
    return parts.smallest(lambda part: smallest_jacobian(x[part.rows_and_next], y[part.rows_and_next]))


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
        x, y = np.empty(grid.shape), np.empty(grid.shape)
        x[:], y[:] = np.linspace(0, 1, grid.n_xi)[:, None], np.linspace(0, 1, grid.n_eta)
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


# The rows of a mesh that are here: nodes, and the cells among them that are measured here.
#
# Rows of cells are measured where they are. The rows of nodes around the next row of cells on either side are here,
# too, since some measures compare a cell with its neighbours. All rows of a mesh are the usual case. Where others
# hold the rest, the rows join and add up what is found in all of them: everybody asks them for the same numbers in
# the same order. Measures do not know who holds the others.


@dataclass(frozen=True, eq=False)
class HeldMesh:
    """The rows ``begin`` to ``end - 1`` of a mesh on ``grid``: ``x`` and ``y`` of shape ``(end - begin, n_eta)``."""

    grid: Grid
    begin: int
    x: Array
    y: Array

    @classmethod
    def of(cls, mesh: Mesh) -> HeldMesh:
        """All rows of a mesh."""
        return cls(mesh.grid, 0, np.ascontiguousarray(mesh.x), np.ascontiguousarray(mesh.y))

    @property
    def end(self) -> int:
        """The row after the last one that is held."""
        return self.begin + len(self.x)

    @property
    def ends(self) -> tuple[int, int]:
        """The first row that is held, and the one after the last."""
        return self.begin, self.end

    @property
    def is_whole(self) -> bool:
        """Whether these are all rows of the grid."""
        return len(self.x) == self.grid.n_xi

    def window(self, begin: int, end: int) -> HeldMesh:
        """The rows ``begin`` to ``end - 1`` of these, in the same memory."""
        rows = slice(begin - self.begin, end - self.begin)
        return HeldMesh(self.grid, begin, self.x[rows], self.y[rows])

    def with_rows(self, wanted: Sequence[tuple[int, int]], channel: Channel) -> HeldMesh:
        """The own rows of this process, and those that it wants, from the processes that own them.

        ``wanted`` are the first row that every process wants, and the one after the last. Every process calls this.
        """
        cuts, here = row_cuts(self.grid.shape, channel.count), channel.number
        own = list(pairwise(cuts))
        ranges = [(min(rows[0], kept[0]), max(rows[1], kept[1])) for rows, kept in zip(wanted, own, strict=True)]
        for other, rows in enumerate(ranges):
            begin, end = max(rows[0], own[here][0]), min(rows[1], own[here][1])
            if other != here and begin < end:
                sent = self.window(begin, end)
                channel.send(other, "rows", [sent.x, sent.y])
        mine, pieces = self.window(*own[here]), list[Sequence[Array]]()
        for other, rows in enumerate(own):
            begin, end = max(ranges[here][0], rows[0]), min(ranges[here][1], rows[1])
            if other == here:
                pieces.append((mine.x, mine.y))
            elif begin < end:
                pieces.append(channel.receive(other, "rows"))
        x, y = (np.concatenate(rows) for rows in zip(*pieces, strict=True))
        return HeldMesh(self.grid, ranges[here][0], x, y)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """The rows of a grid of ``shape`` nodes that are here.

    The own cells are those of the rows ``first`` to ``last - 1``. The first row of nodes that is here is ``begin``.
    The ``channel`` leads to the holders of the other rows.
    """

    shape: tuple[int, int]
    begin: int
    first: int
    last: int
    channel: Channel = field(default=ALONE, repr=False)

    @classmethod
    def whole(cls, shape: tuple[int, int]) -> Rows:
        """All rows."""
        return cls(shape=shape, begin=0, first=0, last=shape[0] - 1)

    @cached_property
    def cells(self) -> tuple[int, int]:
        """Cells of the whole grid along xi and along eta."""
        return self.shape[0] - 1, self.shape[1] - 1

    @cached_property
    def own(self) -> slice:
        """The numbers of the own cells, among those of the whole grid."""
        return slice(self.first * self.cells[1], self.last * self.cells[1])

    @cached_property
    def strips(self) -> tuple[tuple[int, int], ...]:
        """The own rows of cells, cut where the grid has its strips: a sum over cells is one of sums over strips.

        Parts that are cut at strips give the same sums, to the last bit, whatever their number.
        """
        ends = [0, *(last for _, last in Parts.of(self.shape).strips[:-1]), self.cells[0]]
        found = ((max(one, self.first), min(two, self.last)) for one, two in pairwise(ends))
        return tuple((one, two) for one, two in found if one < two)

    @property
    def are_all(self) -> bool:
        """Whether all rows of the grid are here."""
        return self.channel.count == 1

    def joined(self, found: Array) -> Array:
        """What was found in all rows of the grid, along the first axis in the order of the rows."""
        return joined(self.channel, found)

    def summed(self, found: Array) -> Array:
        """The sum over all rows of the grid, from what was ``found`` here."""
        return summed(self.channel, found)

    def total(self, strips: Array) -> Array:
        """The sum of the numbers of all strips of the grid, from those of the own strips, shape ``(strips, …)``."""
        return np.asarray(self.joined(strips).sum(axis=0))


@dataclass(frozen=True, eq=False)
class MeshWindow:
    """Nodes ``x`` and ``y`` of the ``rows`` that are here, C-contiguous, of shape ``(rows, n_eta)``."""

    x: Array
    y: Array
    rows: Rows

    @classmethod
    def of(cls, mesh: Mesh | MeshWindow) -> MeshWindow:
        """The same mesh; all rows of a whole one."""
        if isinstance(mesh, MeshWindow):
            return mesh
        x, y = (np.ascontiguousarray(q, dtype=float) for q in (mesh.x, mesh.y))
        return cls(x, y, Rows.whole((x.shape[0], x.shape[1])))

    @classmethod
    def uniform(cls, rows: Rows, count: int) -> MeshWindow:
        """The uniform mesh of the unit square, of which ``count`` rows are here."""
        s, t = (np.linspace(0.0, 1.0, n) for n in rows.shape)
        x, y = np.meshgrid(s[rows.begin : rows.begin + count], t, indexing="ij")
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

    def nodes(self, first: int, last: int) -> tuple[Array, Array]:
        """x and y around the rows ``first`` to ``last - 1`` of cells, counted from the first row of the grid."""
        here = slice(first - self.rows.begin, last + 1 - self.rows.begin)
        return self.x[here], self.y[here]

    def strips(self) -> Iterator[tuple[Array, Array]]:
        """x and y around the cells of every strip of own rows."""
        return (self.nodes(first, last) for first, last in self.rows.strips)


@dataclass(frozen=True, eq=False)
class WindowCells:
    """Some own cells: their ``numbers`` in the whole grid, increasing, and where each strip ends.

    Strip ``k`` has the places from ``ends[k]`` to before ``ends[k + 1]``. ``columns`` are the cells of a row.
    """

    numbers: IntArray
    ends: IntArray
    columns: int
    rows: Rows

    @classmethod
    def of(cls, rows: Rows, numbers: IntArray | None = None) -> WindowCells:
        """All own cells, or those with these ``numbers``."""
        columns = rows.cells[1]
        ends = np.array([rows.first, *(last for _, last in rows.strips)]) * columns
        if numbers is None:
            return cls(np.arange(rows.own.start, rows.own.stop), ends - rows.own.start, columns, rows)
        return cls(numbers, np.searchsorted(numbers, ends), columns, rows)

    def repeated(self, times: int) -> WindowCells:
        """So many pieces of every cell, next to each other along eta."""
        numbers = (times * self.numbers[:, None] + np.arange(times)).reshape(-1)
        return WindowCells(numbers, times * self.ends, times * self.columns, self.rows)

    def count(self) -> int:
        """The number of such cells in all rows of the grid."""
        return int(self.rows.summed(np.array([float(self.numbers.size)]))[0])

    def total(self, values: Array) -> Array:
        """The sums of ``values``, shape ``(k, cells)``, over such cells in all rows; shape ``(k,)``."""
        spans = pairwise(self.ends)
        strips = np.array([[row[one:two].sum() for row in values] for one, two in spans])
        return self.rows.total(strips.reshape(-1, len(values)))
