"""The rows of a mesh that one process holds, and the cells among them that it measures.

A process measures rows of cells of its own. It also holds the rows of nodes around the next row of cells on either
side, since some measures compare a cell with its neighbours. The whole mesh is the case of one process.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.mesh_part import MeshPart
from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import ALONE, Channel
from equimesh.numerics.gather import joined, summed
from equimesh.numerics.types import Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowRows:
    """The rows of a grid of ``shape`` nodes that a process holds.

    Its own cells are those of the rows ``first`` to ``last - 1``. The first row of nodes that it holds is ``begin``.
    The ``channel`` leads to the processes that hold the others.
    """

    shape: tuple[int, int]
    begin: int
    first: int
    last: int
    channel: Channel = field(default=ALONE, repr=False)

    @classmethod
    def whole(cls, shape: tuple[int, int]) -> WindowRows:
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

    def total(self, strips: Array) -> Array:
        """The sum of the numbers of all strips of the grid, from those of the own strips, shape ``(strips, …)``."""
        return np.asarray(joined(self.channel, strips).sum(axis=0))


@dataclass(frozen=True, eq=False)
class MeshWindow:
    """Nodes ``x`` and ``y`` of the held ``rows``, C-contiguous, of shape ``(held rows, n_eta)``."""

    x: Array
    y: Array
    rows: WindowRows

    @classmethod
    def of(cls, mesh: Mesh | MeshWindow) -> MeshWindow:
        """The same mesh; a whole one as held by one process."""
        if isinstance(mesh, MeshWindow):
            return mesh
        x, y = (np.ascontiguousarray(q, dtype=float) for q in (mesh.x, mesh.y))
        return cls(x, y, WindowRows.whole((x.shape[0], x.shape[1])))

    @classmethod
    def uniform(cls, rows: WindowRows, count: int) -> MeshWindow:
        """The uniform mesh of the unit square, of which ``count`` rows are held."""
        s, t = (np.linspace(0.0, 1.0, n) for n in rows.shape)
        x, y = np.meshgrid(s[rows.begin : rows.begin + count], t, indexing="ij")
        return cls(x, y, rows)

    @classmethod
    def of_part(cls, part: MeshPart, channel: Channel) -> MeshWindow:
        """The rows that part ``channel.number`` of a mesh needs; all parts call this, and get rows of each other."""
        first, last = part.cell_rows
        before, after = channel.number - 1, channel.number + 1
        if before >= 0 and last > first:
            channel.send(before, "window", [part.x[1], part.y[1]])
        if after < channel.count and not part.is_last:
            channel.send(after, "window", [part.x[part.last - 1 - first], part.y[part.last - 1 - first]])
        below = channel.receive(before, "window") if before >= 0 else (part.x[:0], part.y[:0])
        above = channel.receive(after, "window") if last < part.grid.n_xi - 1 else (part.x[:0], part.y[:0])
        x, y = (np.vstack(rows) for rows in zip(below, (part.x, part.y), above, strict=True))
        begin = first - (before >= 0)
        return cls(x, y, WindowRows(shape=part.grid.shape, begin=begin, first=first, last=last, channel=channel))

    @property
    def grid(self) -> Grid:
        """The grid of the whole mesh."""
        return Grid(n_xi=self.rows.shape[0], n_eta=self.rows.shape[1])

    @property
    def min_jacobian(self) -> float:
        """As :attr:`~equimesh.meshes.mesh.Mesh.min_jacobian`, of the whole mesh; all processes have to ask."""
        rows = self.rows
        here = [smallest_jacobian(*self.nodes(rows.first, rows.last))] if rows.first < rows.last else []
        return float(joined(rows.channel, np.array(here)).min() * (rows.cells[0] * rows.cells[1]))

    def nodes(self, first: int, last: int) -> tuple[Array, Array]:
        """x and y around the rows ``first`` to ``last - 1`` of cells, counted from the first row of the grid."""
        here = slice(first - self.rows.begin, last + 1 - self.rows.begin)
        return self.x[here], self.y[here]

    def strips(self) -> Iterator[tuple[Array, Array]]:
        """x and y around the cells of every strip of own rows."""
        return (self.nodes(first, last) for first, last in self.rows.strips)


@dataclass(frozen=True, eq=False)
class WindowCells:
    """Some own cells of a process: their ``numbers`` in the whole grid, increasing, and where each strip ends.

    Strip ``k`` has the places from ``ends[k]`` to before ``ends[k + 1]``. ``columns`` are the cells of a row.
    """

    numbers: IntArray
    ends: IntArray
    columns: int
    rows: WindowRows

    @classmethod
    def of(cls, rows: WindowRows, numbers: IntArray | None = None) -> WindowCells:
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
        """The number of such cells of all processes."""
        return int(summed(self.rows.channel, np.array([float(self.numbers.size)]))[0])

    def total(self, values: Array) -> Array:
        """The sums of ``values``, shape ``(k, cells)``, over such cells of all processes; shape ``(k,)``."""
        spans = pairwise(self.ends)
        strips = np.array([[row[one:two].sum() for row in values] for one, two in spans])
        return self.rows.total(strips.reshape(-1, len(values)))
