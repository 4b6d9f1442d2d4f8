"""The rows of a mesh that are here: nodes, and the cells among them that are measured here.

Rows of cells are measured where they are. The rows of nodes around the next row of cells on either side are here, too,
since some measures compare a cell with its neighbours. All rows of a mesh are the usual case. Where others hold the
rest, the rows join and add up what is found in all of them: everybody asks them for the same numbers in the same order.
Measures do not know who holds the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from equimesh.meshes.mesh import Grid, Mesh, smallest_jacobian
from equimesh.meshes.parts import Parts, row_cuts
from equimesh.numerics.channel import ALONE, Channel, joined, summed
from equimesh.numerics.types import Array, IntArray


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
