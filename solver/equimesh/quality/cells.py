"""The cells of a mesh as bilinear quadrilaterals, the images of the unit square."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from equimesh.domains.domain import Domain, Rectangle
from equimesh.meshes.cell_edges import CellEdges
from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.nested import OPEN, Closed
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cell_maps import (
    gather_cells,
    gather_corners,
    gather_row_of_cells,
    gather_values,
    map_cells,
    measure_cells,
    measure_corners,
    sum_of_rows,
)
from equimesh_coupling.elements import gauss
from equimesh_coupling.parts import corner_cuts, cuts_at_corners

BLOCK_POINTS = 6 << 10
"""Points of a block of cells: its arrays stay in the cache, and memory that is here already has room for them."""

Block: TypeAlias = slice | IntArray
"""Some cells: consecutive ones, from ``start`` to before ``stop``, or those with these numbers."""


class CellPoints(NamedTuple):
    """Points (s, t) of the unit square with weights, flat arrays: s runs with xi, t with eta."""

    s: Array
    t: Array
    weights: Array

    @classmethod
    @cache
    def gauss(cls, count: int) -> CellPoints:
        """The tensor-product Gauss rule with ``count`` points per direction; the weights sum to 1."""
        nodes, weights = gauss(count)
        s, t = np.meshgrid(nodes, nodes, indexing="ij")
        return cls(s.ravel(), t.ravel(), np.outer(weights, weights).ravel())

    @classmethod
    @cache
    def corners(cls) -> CellPoints:
        """The four corners with equal weights, counter-clockwise: the trapezoidal rule, exact for linear functions."""
        return cls(np.array([0.0, 1.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0, 1.0]), np.full(4, 0.25))


class CellMap(NamedTuple):
    """The bilinear map at points of some cells: position, Jacobian matrix and its determinant.

    All of shape ``(points, cells)``.
    """

    x: Array
    y: Array
    x_s: Array
    y_s: Array
    x_t: Array
    y_t: Array
    det: Array


@dataclass(frozen=True, eq=False)
class ChosenCells:
    """Some own cells: their ``numbers`` in the whole grid, increasing, and where each strip ends.

    Strip ``k`` has the places from ``ends[k]`` to before ``ends[k + 1]``. ``columns`` are the cells of a row.
    """

    numbers: IntArray
    ends: IntArray
    columns: int
    rows: Rows

    @classmethod
    def of(cls, rows: Rows, numbers: IntArray | None = None) -> ChosenCells:
        """All own cells, or those with these ``numbers``."""
        columns = rows.cells[1]
        ends = np.array([rows.first, *(last for _, last in rows.strips)]) * columns
        if numbers is None:
            return cls(np.arange(rows.own.start, rows.own.stop), ends - rows.own.start, columns, rows)
        return cls(numbers, np.searchsorted(numbers, ends), columns, rows)

    def repeated(self, times: int) -> ChosenCells:
        """So many pieces of every cell, next to each other along eta."""
        numbers = (times * self.numbers[:, None] + np.arange(times)).reshape(-1)
        return ChosenCells(numbers, times * self.ends, times * self.columns, self.rows)

    def count(self) -> int:
        """The number of such cells in all rows of the grid."""
        size = self.numbers.size
        return size if self.rows.are_all else int(self.rows.summed(np.array([float(size)]))[0])

    def total(self, values: Array) -> Array:
        """The sums of ``values``, shape ``(k, cells)``, over such cells in all rows; shape ``(k,)``."""
        strips = np.array([values[:, one:two].sum(axis=1) for one, two in pairwise(self.ends)])
        return self.rows.total(strips.reshape(-1, len(values)))


class Cells(ABC):
    """Bilinear cells in rows and columns, numbered as in :class:`~equimesh.meshes.mesh.Mesh`.

    Own cells are the cells of the rows that are here. They have the numbers of the whole mesh.
    """

    @property
    @abstractmethod
    def rows(self) -> Rows:
        """The rows of the mesh that are here."""

    @property
    @abstractmethod
    def all_valid(self) -> bool:
        """Whether no cell is folded."""

    @property
    @abstractmethod
    def total_area(self) -> float:
        """Signed area of all cells."""

    @abstractmethod
    def corners(self, cells: Block) -> Array:
        """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""

    @property
    def lines(self) -> Pair | None:
        """x and y of the lines around own cells, where all are known to be parallel to the axes; ``None`` elsewhere."""
        return None

    @property
    def shape(self) -> tuple[int, int]:
        """Cells of the whole mesh along xi and along eta."""
        return self.rows.cells

    @property
    def count(self) -> int:
        """Number of cells of the whole mesh."""
        return self.shape[0] * self.shape[1]

    @property
    def across(self) -> float:
        """Cells along a line across the mesh: of the longer lines of a grid, else as if it were a square."""
        return max(self.shape)

    @property
    def own(self) -> slice:
        """The numbers of the own cells."""
        return self.rows.own

    def blocks(self, points: CellPoints) -> Iterator[slice]:
        """All own cells, in pieces of about ``BLOCK_POINTS`` points that are the same for any number of holders."""
        columns, size = self.shape[1], cells_of_block(points)
        for first, last in self.rows.strips:
            yield from pieces(first * columns, last * columns, size)

    def blocks_of(self, chosen: ChosenCells, points: CellPoints) -> Iterator[tuple[slice, IntArray]]:
        """The places and the numbers of the ``chosen`` cells, in such pieces."""
        for start, end in pairwise(chosen.ends):
            for piece in pieces(int(start), int(end), cells_of_block(points)):
                yield piece, chosen.numbers[piece]

    def at(self, points: CellPoints, cells: Block) -> CellMap:
        """The map of ``cells`` at ``points``."""
        corners = self.corners(cells)
        out = np.empty((7, points.s.size, corners.shape[1]))
        map_cells(corners, points.s, points.t, out)
        return CellMap(*out)


def cells_of_block(points: CellPoints) -> int:
    """The cells of a block of about ``BLOCK_POINTS`` points."""
    return max(1, BLOCK_POINTS // points.s.size)


def pieces(start: int, end: int, size: int) -> Iterator[slice]:
    """The numbers from ``start`` to before ``end`` in pieces of ``size``."""
    for first in range(start, end, size):
        yield slice(first, min(first + size, end))


@dataclass(frozen=True, eq=False)
class UniformCells(Cells):
    """The cells of the uniform mesh of a domain. Only the cells that are used are computed.

    The mesh must be known to be valid.
    """

    grid: Grid
    domain: Domain
    window: Rows | None = None

    @property
    def rows(self) -> Rows:
        """The rows of the mesh that are here: all of them, unless others are given."""
        return self.window or Rows.whole(self.grid.shape)

    @property
    def all_valid(self) -> bool:
        """True: no cell is folded."""
        return True

    @property
    def total_area(self) -> float:
        """The area of the domain."""
        return self.domain.area

    def corners(self, cells: Block) -> Array:
        """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""
        numbers = np.arange(cells.start, cells.stop) if isinstance(cells, slice) else cells
        i = numbers // self.shape[1]
        j, (s, t), out = numbers - i * self.shape[1], self._lines, np.empty((8, numbers.size))
        out[0] = out[3] = s[i]
        out[1] = out[2] = s[i + 1]
        out[4] = out[5] = t[j]
        out[6] = out[7] = t[j + 1]
        if not isinstance(self.domain, Rectangle):
            out[:4], out[4:] = self.domain.map(out[:4], out[4:])
        return out

    @property
    def lines(self) -> Pair | None:
        """x and y of the lines around own cells of a rectangle; ``None`` in other domains."""
        (x, y), rows = self._lines, self.rows
        return (x[rows.first : rows.last + 1], y) if isinstance(self.domain, Rectangle) else None

    @cached_property
    def _lines(self) -> Pair:
        """The lines of the uniform mesh of a rectangle; those of the unit square for other domains."""
        x, y = np.linspace(0.0, 1.0, self.grid.n_xi), np.linspace(0.0, 1.0, self.grid.n_eta)
        if not isinstance(self.domain, Rectangle) or self.domain.is_unit_square:
            return x, y
        return self.domain.map(x, x)[0], self.domain.map(y, y)[1]


AnyMesh: TypeAlias = Mesh | MeshRows
"""A mesh, or some rows of a grid."""


class MeshCells(Cells):
    """The cells of a mesh with nodes, which may be folded."""

    mesh: AnyMesh

    @property
    @abstractmethod
    def nodes(self) -> tuple[Array, Array]:
        """x and y of the held nodes, C-contiguous."""

    @property
    @abstractmethod
    def _measured(self) -> tuple[Array, BoolArray, float]:
        """Area and validity of all held cells, and the smallest determinant at a corner of them."""

    @property
    def area(self) -> Array:
        """Signed area of all held cells, shape ``(cells,)``; the own cells are at :meth:`places`."""
        return self._measured[0]

    @property
    def valid(self) -> BoolArray:
        """Whether the map is one to one, of all held cells; cells where it is not are folded."""
        return self._measured[1]

    @property
    def lowest(self) -> float:
        """The smallest determinant of the Jacobian matrix at a corner; NaN where a coordinate is not finite."""
        return self._measured[2]

    @property
    def all_valid(self) -> bool:
        """Whether no cell of the whole mesh is folded."""
        return self.lowest > 0.0

    @property
    @abstractmethod
    def own_shape(self) -> tuple[int, ...]:
        """The shape of one value for each own cell."""

    @property
    @abstractmethod
    def cuts(self) -> dict[int, int]:
        """The cells that are cut through a corner of the domain, by their places among the own cells.

        :func:`~equimesh_coupling.parts.corner_cuts` makes the cuts.
        """

    @abstractmethod
    def places(self, cells: slice) -> slice:
        """The places of consecutive cells among the held cells."""

    @abstractmethod
    def corner_values(self, nodal: Array, cells: IntArray) -> Array:
        """Values at the held nodes at the corners of ``cells``, counter-clockwise, shape ``(4, cells)``."""

    @property
    def grid_nodes(self) -> Pair:
        """The same as arrays of rows; one row where the nodes form no grid."""
        x, y = self.nodes
        return (x, y) if x.ndim > 1 else (x[None], y[None])

    @property
    @abstractmethod
    def tables(self) -> tuple[IntArray, IntArray]:
        """The nodes of every held cell and its edge neighbours or -1, shapes ``(cells, 4)``.

        No nodes where they are those of rows.
        """


@dataclass(frozen=True, eq=False)
class BilinearCells(MeshCells):
    """All cells of a grid of nodes, numbered as in :class:`~equimesh.meshes.mesh.Mesh`.

    Cells on both sides of the seam of ``closed`` lines are neighbours; all rows of such a mesh are here.
    """

    mesh: Mesh | MeshRows
    closed: Closed = OPEN
    _found: list[tuple[float, float]] = field(default_factory=list, init=False, repr=False)

    @cached_property
    def window(self) -> MeshRows:
        """The nodes of the rows that are here."""
        return MeshRows.of(self.mesh)

    @cached_property
    def rows(self) -> Rows:
        """The rows of the mesh that are here."""
        return self.window.rows

    @property
    def nodes(self) -> tuple[Array, Array]:
        """x and y of the held nodes, C-contiguous."""
        return self.window.x, self.window.y

    @property
    def lowest(self) -> float:
        """The smallest determinant of the Jacobian matrix at a corner; NaN where a coordinate is not finite."""
        return self._of_all()[0]

    @property
    def total_area(self) -> float:
        """Signed area of the whole mesh."""
        return self._of_all()[1]

    @property
    def own_shape(self) -> tuple[int, ...]:
        """The shape of one value for each own cell: rows and columns."""
        return self.rows.last - self.rows.first, self.shape[1]

    @property
    def cuts(self) -> dict[int, int]:
        """The cells that are cut through a corner of the domain, by their places among the own ones."""
        own = self.own
        return {cell - own.start: cut for cell, cut in corner_cuts(self.shape).items() if own.start <= cell < own.stop}

    def places(self, cells: slice) -> slice:
        """The places of consecutive cells among the held cells."""
        shift = self.rows.begin * self.shape[1]
        return slice(cells.start - shift, cells.stop - shift)

    def corners(self, cells: Block) -> Array:
        """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""
        if isinstance(cells, slice):
            out = np.empty((8, cells.stop - cells.start))
            gather_row_of_cells(*self.nodes, self.places(cells).start, out)
        else:
            out = np.empty((8, cells.size))
            gather_cells(*self.nodes, self._numbers_here(cells), out)
        return out

    def corner_values(self, nodal: Array, cells: IntArray) -> Array:
        """Values at the held nodes at the corners of ``cells``, counter-clockwise, shape ``(4, cells)``."""
        out = np.empty((4, cells.size))
        gather_values(np.ascontiguousarray(nodal), self._numbers_here(cells), out)
        return out

    @cached_property
    def tables(self) -> tuple[IntArray, IntArray]:
        """No nodes, since they are those of rows, and the edge neighbours of every held cell, also across seams."""
        held = (len(self.nodes[0]) - 1) * self.shape[1]
        numbers, found = np.arange(held).reshape(-1, self.shape[1]), []
        for axis, is_closed in enumerate(self.closed):
            for step, side in ((1, 0), (-1, -1)):
                beside = np.roll(numbers, step, axis)
                if not is_closed:
                    np.moveaxis(beside, axis, 0)[side] = -1
                found.append(beside.ravel())
        return np.empty((0, 4), dtype=np.int64), np.ascontiguousarray(np.stack(found, axis=1))

    def _numbers_here(self, cells: IntArray) -> IntArray:
        return cells - self.rows.begin * self.shape[1] if self.rows.begin else cells

    @cached_property
    def _measured(self) -> tuple[Array, BoolArray, float]:
        x, y = self.nodes
        count = (x.shape[0] - 1) * (x.shape[1] - 1)
        area, valid = np.empty(count), np.empty(count, dtype=np.bool_)
        return area, valid, measure_cells(x, y, area, valid)

    def know(self, lowest: float, total_area: float) -> None:
        """Keep the smallest determinant and the area of the whole mesh, which are known from elsewhere."""
        if not self._found:
            self._found.append((lowest, total_area))

    def _of_all(self) -> tuple[float, float]:
        """The smallest determinant and the area of the whole mesh.

        A cached property of Python 3.11 has one lock for all objects: parts that are threads would wait for each other.
        """
        if not self._found:
            columns = self.shape[1]
            spans = (self.places(slice(first * columns, last * columns)) for first, last in self.rows.strips)
            here = np.array(
                [(self._measured[2], sum_of_rows(self.area[span].reshape(-1, columns))) for span in spans]
            ).reshape(-1, 2)
            found = self.rows.joined(here)
            self.know(float(found[:, 0].min()), float(found[:, 1].sum()))
        return self._found[0]


# The cells of a mesh of blocks as bilinear quadrilaterals: one row of cells after the other, in one column.


@dataclass(frozen=True, eq=False)
class QuadCells(MeshCells):
    """All cells of a mesh of blocks, with the numbers that they have there.

    They count as one column of cells, since they have no rows of more: sums go over runs of consecutive cells.
    """

    mesh: Mesh

    @cached_property
    def rows(self) -> Rows:
        """One column with all cells."""
        return Rows.whole((len(self.mesh.cells) + 1, 2))

    @cached_property
    def nodes(self) -> tuple[Array, Array]:
        """x and y of the nodes, shape ``(n,)``."""
        x, y = (np.array(q, dtype=float, order="C").reshape(-1) for q in (self.mesh.x, self.mesh.y))
        return x, y

    @cached_property
    def total_area(self) -> float:
        """Signed area of the mesh."""
        return float(self.area.sum())

    @property
    def across(self) -> float:
        """The root of the number of cells."""
        return math.sqrt(self.count)

    @property
    def own_shape(self) -> tuple[int, ...]:
        """The shape of one value for each cell: ``(m,)``."""
        return (len(self.mesh.cells),)

    @property
    def cuts(self) -> dict[int, int]:
        """The cells that are cut through a corner of the domain."""
        return cuts_at_corners(self.mesh.cells)

    @cached_property
    def edges(self) -> CellEdges:
        """The edges. An edge of a periodic join is counted once."""
        return CellEdges.of(self.mesh.cells, len(self.mesh.points), self.mesh.ties)

    def places(self, cells: slice) -> slice:
        """The places of consecutive cells: their numbers, since all cells are held."""
        return cells

    def corners(self, cells: Block) -> Array:
        """x and then y of the corners of ``cells``, counter-clockwise, shape ``(8, cells)``."""
        chosen = self.mesh.cells[cells]
        out = np.empty((8, len(chosen)))
        gather_corners(*self.nodes, np.ascontiguousarray(chosen), out)
        return out

    def corner_values(self, nodal: Array, cells: IntArray) -> Array:
        """Values at the nodes at the corners of ``cells``, counter-clockwise, shape ``(4, cells)``."""
        return np.ascontiguousarray(np.asarray(nodal)[self.mesh.cells[cells]].T)

    @cached_property
    def tables(self) -> tuple[IntArray, IntArray]:
        """The nodes of every cell and its edge neighbours."""
        return np.array(self.mesh.cells, dtype=np.int64, order="C"), np.ascontiguousarray(self.edges.neighbours)

    @cached_property
    def _measured(self) -> tuple[Array, BoolArray, float]:
        count = len(self.mesh.cells)
        area, valid = np.empty(count), np.empty(count, dtype=np.bool_)
        return area, valid, measure_corners(self.corners(slice(0, count)), area, valid)


def cells_of(mesh: AnyMesh, closed: Closed = OPEN) -> BilinearCells | QuadCells:
    """The cells of any mesh; lines of a grid may be ``closed``."""
    return BilinearCells(mesh, closed) if isinstance(mesh, MeshRows) or mesh.is_grid else QuadCells(mesh)


# The angles at the corners of the cells.

FROM_DEGREES = 30.0
"""The smallest angle that many solvers take without complaint."""
TO_DEGREES = 150.0
"""The largest such angle."""


@dataclass(frozen=True, kw_only=True)
class Angles:
    """The angles at the corners of all cells, in degrees; some are larger than 180 where a cell is folded."""

    smallest: float
    """The smallest angle."""
    largest: float
    """The largest angle."""
    share_within: float
    """The share of the corners whose angle is between ``FROM_DEGREES`` and ``TO_DEGREES``."""

    def summary(self) -> dict[str, float]:
        """The three numbers as plain Python data, ready for JSON."""
        return {"min": self.smallest, "max": self.largest, "share_within": self.share_within}


def corner_angles(mesh: Mesh) -> Array:
    """The angle at each corner of each cell, from 0 to 360 degrees, shape ``(4, cells)``, counter-clockwise."""
    cells = cells_of(mesh)
    corners = cells.corners(cells.own)
    x, y = corners[:4], corners[4:]
    ahead_x, ahead_y = np.roll(x, -1, axis=0) - x, np.roll(y, -1, axis=0) - y
    behind_x, behind_y = np.roll(x, 1, axis=0) - x, np.roll(y, 1, axis=0) - y
    turned = np.arctan2(ahead_x * behind_y - ahead_y * behind_x, ahead_x * behind_x + ahead_y * behind_y)
    return np.asarray(np.degrees(turned) % 360.0)


def measure_angles(mesh: Mesh, *, from_degrees: float = FROM_DEGREES, to_degrees: float = TO_DEGREES) -> Angles:
    """The measures of the angles of ``mesh``; the share is that between the two angles given."""
    found = corner_angles(mesh)
    within = (found >= from_degrees) & (found <= to_degrees)
    return Angles(smallest=float(found.min()), largest=float(found.max()), share_within=float(within.mean()))
