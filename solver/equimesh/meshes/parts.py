"""The rows of a grid that are here, shared out among threads, and the tree by which sums over all rows are added.

A process holds its own rows and one more each way, where there are more. Processes are the parts of a channel; threads
share what their process holds. Both are cut between strips, which depend on the grid alone. The whole grid in one
process is the case of one part, which holds all rows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from equimesh.errors import InputError
from equimesh.numerics.channel import ALONE, Channel, Communicator, agree
from equimesh.numerics.types import Array, IntArray

# Strips of rows, and the binary tree over them by which sums over all rows are added.
#
# A strip is a block of rows whose intermediate arrays stay in the cache. Strips depend on the grid alone, and so does
# the tree: the strips ``first`` to ``last - 1`` are cut in the middle into two nodes, until a node is one strip. A
# sum over all rows is added up this tree, in each process; so no result depends on the number of threads or of parts,
# to the last bit.

# Nodes of a strip of rows: its intermediate arrays stay in the cache.
STRIP_NODES = 32_768
# Rows of a strip, at least: each strip also reads one row beyond either end.
MIN_STRIP_ROWS = 16
# Parts whose number is no power of two are cut at nodes that are deeper in the tree by so much: their sizes are then
# nearly equal, and few sums travel.
EXTRA_DEPTH = 2


class Node(NamedTuple):
    """The strips ``first`` to ``last - 1``, cut before the strip ``middle``."""

    first: int
    middle: int
    last: int

    @classmethod
    def of(cls, first: int, last: int) -> Node:
        """The node of these strips; one strip is not cut, and has itself for ``middle``."""
        return cls(first, (first + last) // 2, last)


@lru_cache(maxsize=256)
def strips_of(shape: tuple[int, int]) -> tuple[tuple[int, int], ...]:
    """The first row and the row after the last one of each strip: all rows but the first and the last of the grid."""
    rows, columns = shape
    height = max(MIN_STRIP_ROWS, -(-STRIP_NODES // columns))
    return tuple((first, min(first + height, rows - 1)) for first in range(1, rows - 1, height))


@lru_cache(maxsize=256)
def cuts_of(strips: int, parts: int) -> tuple[int, ...]:
    """The first strip of each of ``parts`` parts, and the number of ``strips``.

    Parts are cut at nodes of the tree. Those of a power of two in number are nodes themselves; others have nearly equal
    numbers of strips. Raises :class:`~equimesh.errors.InputError` for more parts than strips.
    """
    if not 1 <= parts <= strips:
        raise InputError(f"the rows of this grid can be cut into at most {strips} parts, not {parts}", field="parts")
    depth = (parts - 1).bit_length()
    if parts == 2**depth:
        return 0, *(node.middle for node in _inner_nodes(strips, depth)), strips
    ends = sorted({0, strips, *(node.middle for node in _inner_nodes(strips, depth + EXTRA_DEPTH))})
    return tuple(min(ends, key=lambda end: abs(end * parts - k * strips)) for k in range(parts + 1))


def _inner_nodes(strips: int, depth: int) -> list[Node]:
    """The nodes of fewer than ``depth`` cuts that have more than one strip, in the order of their middles."""
    found: list[Node] = []

    def visit(node: Node, level: int) -> None:
        if level < depth and node.last - node.first > 1:
            visit(Node.of(node.first, node.middle), level + 1)
            found.append(node)
            visit(Node.of(node.middle, node.last), level + 1)

    visit(Node.of(0, strips), 0)
    return found


@lru_cache(maxsize=1024)
def nodes_inside(strips: int, first: int, last: int) -> tuple[Node, ...]:
    """The largest nodes of the tree over ``strips`` strips that lie within these, in their order."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if first <= node.first and node.last <= last:
            found.append(node)
        elif node.first < last and first < node.last:
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(0, strips))
    return tuple(found)


@lru_cache(maxsize=1024)
def nodes_across(strips: int, cuts: tuple[int, ...]) -> tuple[Node, ...]:
    """The nodes that lie in more than one part, each before the nodes inside it; ``cuts`` as of :func:`cuts_of`."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if any(node.first < cut < node.last for cut in cuts):
            found.append(node)
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(0, strips))
    return tuple(found)


@lru_cache(maxsize=1024)
def subtree(first: int, last: int) -> IntArray:
    """All nodes of more than one strip in the node of these strips, shape ``(k, 3)``, each before those inside it."""
    found: list[Node] = []

    def visit(node: Node) -> None:
        if node.last - node.first > 1:
            found.append(node)
            visit(Node.of(node.first, node.middle))
            visit(Node.of(node.middle, node.last))

    visit(Node.of(first, last))
    return np.array(found, dtype=np.int64).reshape(-1, 3)


T = TypeVar("T")

# Fewer nodes are not worth a second thread.
MIN_SHARED_NODES = 16_384


@dataclass(frozen=True)
class Part:
    """The node rows ``first`` to ``last - 1``, and the numbers of the ``strips`` inside.

    Every row belongs to one part. The first and the last row of the grid are in no strip.
    """

    first: int
    last: int
    strips: range

    @property
    def ends(self) -> tuple[int, int]:
        """The first row, and the one after the last."""
        return self.first, self.last

    @property
    def rows(self) -> slice:
        """The rows of the part."""
        return slice(self.first, self.last)

    @property
    def rows_and_next(self) -> slice:
        """The rows of the part and the first one of the next part: those of the cells that begin in the part."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True)
class Parts:
    """The rows of a grid of ``shape`` points that this process holds, shared out among its threads.

    ``own`` are the rows and strips that belong to the process, as numbers of the grid. It holds the rows ``begin`` to
    ``end - 1``: its arrays begin with row ``begin``. ``parts`` and ``strips`` count the rows of these arrays:
    ``parts`` are those of the threads, ``strips`` the first row and the row after the last one of each own strip.
    """

    shape: tuple[int, int]
    own: Part
    begin: int
    end: int
    strips: tuple[tuple[int, int], ...]
    parts: tuple[Part, ...]
    communicator: Communicator

    @classmethod
    def of(cls, shape: tuple[int, ...], threads: int = 1, channel: Channel = ALONE) -> Parts:
        """What the part of ``channel`` holds, with a part for each of ``threads`` threads.

        There are fewer where the grid is too small to be shared. Raises :class:`~equimesh.errors.InputError` where it
        has too few rows for the parts of the channel.
        """
        rows, columns = shape
        threads = threads if rows * columns >= MIN_SHARED_NODES else 1
        found = _cut((rows, columns), threads, channel.number, channel.count)
        if channel.count == 1:
            return found
        return replace(found, communicator=Communicator(found.communicator.size, channel))

    @property
    def channel(self) -> Channel:
        """The way to the other processes."""
        return self.communicator.channel

    @property
    def here(self) -> Parts:
        """The same rows and threads, without the other processes: numbers are those of this process alone."""
        return self if self.is_whole else replace(self, communicator=Communicator(self.communicator.size))

    @property
    def is_whole(self) -> bool:
        """Whether this process holds all rows of the grid."""
        return self.channel.count == 1

    @property
    def held_shape(self) -> tuple[int, int]:
        """The shape of the arrays of this process."""
        return self.end - self.begin, self.shape[1]

    @property
    def held(self) -> slice:
        """The rows that this process holds, as numbers of the grid."""
        return slice(self.begin, self.end)

    @property
    def cuts(self) -> tuple[int, ...]:
        """The first row of every process, and the number of rows."""
        return row_cuts(self.shape, self.channel.count)

    def each(self, work: Callable[[Part], T]) -> list[T]:
        """The results of ``work`` for the part of every thread, in the order of the rows."""
        return self.communicator.each(lambda k: work(self.parts[k]))

    def largest(self, work: Callable[[Part], float]) -> float:
        """The largest number of a part, of all processes; NaN where one of them is NaN."""
        return self.communicator.largest(lambda k: work(self.parts[k]))

    def smallest(self, work: Callable[[Part], float]) -> float:
        """The smallest number of a part, of all processes; NaN where one of them is NaN."""
        return self.communicator.smallest(lambda k: work(self.parts[k]))

    def agree(self, *numbers: float) -> tuple[float, ...]:
        """The largest of each number, of all processes; NaN where one of them is NaN."""
        return numbers if self.is_whole else agree(self.channel, *numbers)

    def fill_halos(self, *held: Array) -> None:
        """Take the rows next to the own ones from the processes that own them, for arrays of rows that are held.

        Each process sends its first own row to the part before it, and its last one to the part after it.
        """
        first, last = self.own.first - self.begin, self.own.last - self.begin
        before, after = self.channel.number - 1, self.channel.number + 1
        if before >= 0:
            self.channel.send(before, "halo", [array[first] for array in held])
        if after < self.channel.count:
            self.channel.send(after, "halo", [array[last - 1] for array in held])
        if before >= 0:
            for array, row in zip(held, self.channel.receive(before, "halo"), strict=True):
                array[first - 1] = row
        if after < self.channel.count:
            for array, row in zip(held, self.channel.receive(after, "halo"), strict=True):
                array[last] = row


def row_cuts(shape: tuple[int, int], count: int) -> tuple[int, ...]:
    """The first row of each of ``count`` processes, and the number of rows."""
    strips = strips_of(shape)
    if count == 1:
        return 0, shape[0]
    return 0, *(strips[cut][0] for cut in cuts_of(len(strips), count)[1:-1]), shape[0]


def rows_held(shape: tuple[int, int], count: int) -> list[tuple[int, int]]:
    """The first row that each of ``count`` processes holds, and the one after the last."""
    return with_halos(row_cuts(shape, count))


def with_halos(cuts: Sequence[int]) -> list[tuple[int, int]]:
    """The rows between ``cuts``, of which the last is the number of rows, and one more each way where there is one."""
    return [(max(first - 1, 0), min(last + 1, cuts[-1])) for first, last in pairwise(cuts)]


@lru_cache(maxsize=256)
def _cut(shape: tuple[int, int], most: int, number: int, count: int) -> Parts:
    """Part ``number`` of ``count``, shared by at most ``most`` threads."""
    all_strips, rows = strips_of(shape), row_cuts(shape, count)
    cuts = cuts_of(len(all_strips), count) if count > 1 else (0, len(all_strips))
    own = Part(rows[number], rows[number + 1], range(cuts[number], cuts[number + 1]))
    begin, end = rows_held(shape, count)[number]
    strips = tuple((first - begin, last - begin) for first, last in all_strips[own.strips.start : own.strips.stop])
    threads = max(1, min(most, len(strips)))
    ends = [k * len(strips) // threads for k in range(threads + 1)]
    firsts = [own.first - begin, *(strips[end][0] for end in ends[1:-1]), own.last - begin]
    parts = tuple(Part(firsts[k], firsts[k + 1], range(ends[k], ends[k + 1])) for k in range(threads))
    return Parts(shape, own, begin, end, strips, parts, Communicator(threads))
