"""The sweeps of one of several processes that hold the rows of a grid, and its nested iteration.

The corrections are those of :mod:`equimesh.sweeps`, row by row. What crosses the cuts between the processes is added
here: sums along the xi-lines, the nodes of the sides, the rows next to the own ones, and the numbers by which all
decide.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.nested import prolong_rows, rows_needed
from equimesh.meshes.rows import Node, Rows, strips_of, subtree
from equimesh.numerics.types import Array
from equimesh.single_domain.iteration import Climb
from equimesh.single_domain.level import Level, LevelSolution, Mode, Step, interpolated_level
from equimesh.sweeps.kernels import Lines
from equimesh.sweeps.line_sums import LineSums, add_up, go_down, line_levels, start_after
from equimesh.sweeps.sweep import SideNodes, Sweep
from equimesh_cluster.messages import Channel
from equimesh_cluster.parts.rows import PartRows, cuts_of, nodes_across, nodes_inside, row_cuts, rows_here


class _Cut(NamedTuple):
    """A node that lies in more than one part: the part that adds its sum, and the part that adds its second half's.

    ``levels_first`` tells whether the start of the second half is the first thing that the latter part gets to know.
    """

    node: Node
    owner: int
    right_owner: int
    levels_first: bool


class PartLineSums(LineSums):
    """The sums along the xi-lines from the strips of all processes.

    Each process does the part of it that lies inside its own strips. The sums and starts of the nodes of the tree that
    lie across the cuts travel. The owner of a node is the process that holds its first strip.
    """

    def __init__(self, rows: PartRows, summed: int) -> None:
        super().__init__(rows, summed)
        strips, self._channel = strips_of(rows.shape), rows.channel
        cuts, number = cuts_of(len(strips), rows.channel.count), rows.channel.number
        self._offset, last = cuts[number : number + 2]
        self._inside = nodes_inside(len(strips), self._offset, last)
        self._trees = [subtree(node.first - self._offset, node.last - self._offset) for node in self._inside]
        self._first_rows = [first for first, _ in strips]
        self._first_nodes = np.array(self._first_rows[self._offset : last], dtype=np.int64)
        self._root, self._last = (0, len(strips)), rows.channel.count - 1
        self._cuts = [cut for cut in _cuts(len(strips), cuts) if number in (cut.owner, cut.right_owner)]

    def solve(self, lines: Lines) -> float:
        """Find :attr:`levels` and :attr:`starts` from the sums of the strips of all processes."""
        deviation, number = 0.0, self._channel.number
        known = self._up()
        if number == self._last:
            self._channel.send(0, "push", [self.pushes[1]])
        starts = dict[tuple[int, int], Array]()
        if number == 0:
            (self.pushes[1],) = self._channel.receive(self._last, "push")
            starts[self._root] = np.empty_like(self.first)
            deviation = line_levels(
                self.first, known[self._root], self.pushes, lines, self.edges, self.levels, starts[self._root]
            )
        self._down(known, starts)
        return deviation

    def _up(self) -> dict[tuple[int, int], Array]:
        """The sums of the nodes that this process owns, and of their halves."""
        known = dict[tuple[int, int], Array]()
        for node, tree in zip(self._inside, self._trees, strict=True):
            add_up(self.strips, tree)
            known[node.first, node.last] = self.strips[node.last - 1 - self._offset]
        for (first, middle, last), owner, right_owner, _ in reversed(self._cuts):
            if owner != self._channel.number:
                self._channel.send(owner, "sums", [known[middle, last]])
                continue
            if right_owner != owner:
                (known[middle, last],) = self._channel.receive(right_owner, "sums")
            known[first, last] = known[first, middle] + known[middle, last]
        return known

    def _down(self, known: dict[tuple[int, int], Array], starts: dict[tuple[int, int], Array]) -> None:
        """The starts of all strips of this process, from that of the root; the levels come with the first of them."""
        for (first, middle, last), owner, right_owner, levels_first in self._cuts:
            if owner == self._channel.number:
                starts[first, middle] = start = starts[first, last]
                after = np.empty_like(start)
                rows = self._first_rows[middle] - self._first_rows[first]
                start_after(start, known[first, middle], rows, self.levels, after)
                if right_owner == owner:
                    starts[middle, last] = after
                else:
                    self._channel.send(right_owner, "starts", [*(self.levels if levels_first else ()), after])
            else:
                *levels, starts[middle, last] = self._channel.receive(owner, "starts")
                for mine, received in zip(self.levels, levels, strict=False):
                    mine[:] = received
        for node, tree in zip(self._inside, self._trees, strict=True):
            self.starts[node.first - self._offset] = starts[node.first, node.last]
            go_down(self.strips, tree, self._first_nodes, self.levels, self.starts)


def _cuts(strips: int, cuts: tuple[int, ...]) -> Iterator[_Cut]:
    """All nodes across the ``cuts``, with their owners, each before the nodes inside it."""
    owners = np.searchsorted(cuts, np.arange(strips), side="right") - 1
    told = {0}
    for node in nodes_across(strips, cuts):
        owner, right_owner = int(owners[node.first]), int(owners[node.middle])
        yield _Cut(node, owner, right_owner, right_owner not in told)
        told.add(right_owner)


class PartSweep(Sweep):
    """The sweeps of one process; the others sweep their own rows at the same time.

    Nodes have the rows next to the own ones, before a sweep and after it. Each sweep begins where :meth:`swap` has left
    the one before it.
    """

    rows: PartRows
    # The nodes of the four sides before and after a sweep, in full.
    _side_nodes: SideNodes | None = None
    _moved_side_nodes: SideNodes | None = None

    def _line_sums(self, summed: int) -> LineSums:
        return PartLineSums(self.rows, summed)

    def _sides_before(self, x: Array, y: Array) -> SideNodes:
        if self._side_nodes is None:
            self._side_nodes = SideNodes.of_rows(x, y, self.rows)
        return self._side_nodes

    def _follow(self, along_eta: Array, along_xi: Array) -> None:
        assert self._side_nodes is not None
        self._moved_side_nodes = self._side_nodes.moved(along_eta, along_xi)
        self.rows.fill_halos(self.new_x, self.new_y)

    def _shorten(self, x: Array, y: Array, shorten: Callable[[Array, Array], None]) -> None:
        super()._shorten(x, y, shorten)
        assert self._side_nodes is not None
        assert self._moved_side_nodes is not None
        for moved, old in zip(self._moved_side_nodes, self._side_nodes, strict=True):
            shorten(moved, old)

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        self._side_nodes = self._moved_side_nodes
        return super().swap(x, y)


class PartLevel(Level):
    """The chord iteration on one level. All processes make the same steps, since they agree on the numbers."""

    rows: PartRows

    def _sweep(self) -> Sweep:
        return PartSweep(self.problem.metric, self.problem.boundary, self.rows, self.memory, self._frame)


class PartClimb(Climb):
    """The levels of a nested iteration that begin with number ``first``; all processes of ``channel`` climb together.

    ``solved`` are the last two of the levels below, with at least the rows that this process needs.
    """

    def __init__(
        self,
        problem: Problem,
        mode: Mode,
        threads: int,
        grids: Sequence[Grid],
        solved: Sequence[LevelSolution],
        *,
        channel: Channel,
        first: int,
    ) -> None:
        super().__init__(problem, mode, threads, grids, solved)
        self._channel, self._first = channel, first

    def _rows_of(self, grid: Grid) -> PartRows:
        return PartRows.of(grid.shape, self._threads, self._channel)

    def _guess(self, rows: Rows, extrapolated: bool) -> MeshRows:
        number, points = self._channel.number, [known.grid.n_xi for known in self.solved]
        wanted = [rows_needed(points[-1], rows.shape[0], held) for held in rows_here(rows.shape, self._channel.count)]
        last, coarser = self._with_rows(-1, wanted), None
        if extrapolated:
            coarser = self._with_rows(-2, [rows_needed(points[-2], points[-1], held) for held in wanted])
        return prolong_rows(last.within(*wanted[number]), coarser, rows)

    def _with_rows(self, which: int, wanted: Sequence[tuple[int, int]]) -> MeshRows:
        """One of the last two solutions with the rows that are wanted, which it keeps."""
        solved = self.solved[which]
        begin, end = wanted[self._channel.number]
        if self._channel.count > 1 and solved.step.level >= self._first:
            mesh = with_rows(solved.mesh, wanted, self._channel)
            self.solved[which] = solved = LevelSolution(replace(solved.step, mesh=Mesh(mesh.x, mesh.y)), mesh)
        rows = solved.mesh.rows
        if not (rows.begin <= begin and end <= rows.end):
            raise AssertionError(f"rows {begin} to {end - 1} are needed, {rows.begin} to {rows.end - 1} are here")
        return solved.mesh

    def _level(self, problem: Problem, label: Step, before: LevelSolution | None, tight: bool, memory: Array) -> Level:
        rows = self._rows_of(problem.grid)
        kind = Level if rows.are_all else PartLevel
        return kind(problem, label, before, tight, memory, rows)

    def _without_sweeps(self, problem: Problem, label: Step) -> Generator[Step, None, Step]:
        """The interpolated mesh: a level of many processes is too fine for more than sweeps."""
        if self._channel.count == 1 or not self.solved:
            return (yield from super()._without_sweeps(problem, label))
        return interpolated_level(label, self.solved[-1].step)


def with_rows(mesh: MeshRows, wanted: Sequence[tuple[int, int]], channel: Channel) -> MeshRows:
    """The own rows of this process, and those that it wants, from the processes that own them.

    ``wanted`` are the first row that every process wants, and the one after the last. Every process calls this.
    """
    rows, here = mesh.rows, channel.number
    own = list(pairwise(row_cuts(rows.shape, channel.count)))
    ranges = [(min(one[0], kept[0]), max(one[1], kept[1])) for one, kept in zip(wanted, own, strict=True)]

    def part(begin: int, end: int) -> Sequence[Array]:
        there = slice(begin - rows.begin, end - rows.begin)
        return mesh.x[there], mesh.y[there]

    for other, asked in enumerate(ranges):
        begin, end = max(asked[0], own[here][0]), min(asked[1], own[here][1])
        if other != here and begin < end:
            channel.send(other, "rows", part(begin, end))
    pieces = list[Sequence[Array]]()
    for other, kept in enumerate(own):
        begin, end = max(ranges[here][0], kept[0]), min(ranges[here][1], kept[1])
        if other == here:
            pieces.append(part(*kept))
        elif begin < end:
            pieces.append(channel.receive(other, "rows"))
    x, y = (np.concatenate(found) for found in zip(*pieces, strict=True))
    first, last = own[here][0], min(own[here][1], rows.shape[0] - 1)
    kept_rows = Rows(
        shape=rows.shape, begin=ranges[here][0], end=ranges[here][1], first=first, last=last, threads=rows.threads
    )
    return MeshRows(x, y, kept_rows)
