"""The rows of a grid that are here, shared out among threads, and the tree by which sums over all rows are added.

All rows of a grid are the usual case. :mod:`equimesh_cluster` has rows of which the rest is elsewhere. Rows are cut
between strips, which depend on the grid alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from equimesh.numerics.threads import run_on_threads
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


def sum_of(node: Node, known: Mapping[tuple[int, int], Array]) -> Array:
    """The sum of the strips of a node, added up the tree from the ``known`` sums inside, by first and last strip."""
    found = known.get((node.first, node.last))
    if found is not None:
        return found
    return sum_of(Node.of(node.first, node.middle), known) + sum_of(Node.of(node.middle, node.last), known)


T = TypeVar("T")

# Fewer nodes are not worth a second thread.
MIN_SHARED_NODES = 16_384


@dataclass(frozen=True)
class Share:
    """The rows of one thread: the node rows ``first`` to ``last - 1``, and the numbers of the ``strips`` inside.

    Rows and strips are counted among those that are here. Every own row belongs to one share.
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
        """The rows of the share."""
        return slice(self.first, self.last)

    @property
    def rows_and_next(self) -> slice:
        """The rows of the share and the first one of the next: those of the cells that begin in the share."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """The rows of a grid of ``shape`` nodes that are here: all of them, or some.

    Arrays of nodal values have the rows ``begin`` to ``end - 1`` of the grid. The own cells are those of the rows
    ``first`` to ``last - 1``. The own nodes are the rows with which these begin, and the last row of the grid. Around
    them are rows of neighbours, which a sweep and some measures read. ``threads`` share the own rows.

    Where all rows are here, :meth:`joined`, :meth:`summed` and :meth:`agreed` return what was found. A class of rows
    that are not all here asks for what was found in the others; all of them call these methods in the same order.
    """

    shape: tuple[int, int]
    begin: int
    end: int
    first: int
    last: int
    threads: int = 1

    @classmethod
    def whole(cls, shape: tuple[int, ...], threads: int = 1) -> Rows:
        """All rows, shared by at most so many threads; by one where the grid is small."""
        return _whole(shape[0], shape[1], threads)

    @property
    def are_all(self) -> bool:
        """Whether all rows of the grid are here."""
        return True

    def joined(self, found: Array) -> Array:
        """What was found in all rows of the grid, along the first axis in the order of the rows."""
        return found

    def summed(self, found: Array) -> Array:
        """The sum over all rows of the grid, from what was ``found`` here."""
        return found

    def agreed(self, *numbers: float) -> tuple[float, ...]:
        """The largest of each of the numbers over all rows of the grid; NaN where one of them is NaN."""
        return numbers

    def total(self, strips: Array) -> Array:
        """The sum of the numbers of all strips of the grid, from those of the own strips, shape ``(strips, …)``."""
        return np.asarray(self.joined(strips).sum(axis=0))

    def over_lines(self, strips: Array) -> Array | None:
        """The sums, the largest and the smallest numbers of all strips of the grid, of shape ``(3, n)``.

        ``strips`` of shape ``(strips, 3, n)`` are those of the own strips. Sums are added up the tree. ``None`` where
        somebody else is told.
        """
        sums = {(k, k + 1): strip for k, strip in enumerate(strips[:, 0])}
        return np.stack([sum_of(Node.of(0, len(sums)), sums), strips[:, 1].max(axis=0), strips[:, 2].min(axis=0)])

    def within(self, begin: int, end: int) -> Rows:
        """The rows ``begin`` to ``end - 1`` of these, with the own cells among them."""
        first = max(self.first, begin)
        last = max(first, min(self.last, end - 1))
        return Rows(shape=self.shape, begin=begin, end=end, first=first, last=last, threads=self.threads)

    @property
    def here_shape(self) -> tuple[int, int]:
        """The shape of arrays of nodal values."""
        return self.end - self.begin, self.shape[1]

    @property
    def here(self) -> slice:
        """The rows that are here, as numbers of the grid."""
        return slice(self.begin, self.end)

    @property
    def own_nodes(self) -> slice:
        """The own rows of nodes, counted from the first row that is here."""
        has_last = self.first < self.last == self.shape[0] - 1
        return slice(self.first - self.begin, self.last + has_last - self.begin)

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
        ends = [0, *(last for _, last in strips_of(self.shape)[:-1]), self.cells[0]]
        found = ((max(one, self.first), min(two, self.last)) for one, two in pairwise(ends))
        return tuple((one, two) for one, two in found if one < two)

    @cached_property
    def node_strips(self) -> tuple[tuple[int, int], ...]:
        """The first row and the row after the last one of each own strip of nodes, counted from :attr:`begin`."""
        own = [(one, two) for one, two in strips_of(self.shape) if self.first <= one and two <= self.last]
        return tuple((one - self.begin, two - self.begin) for one, two in own)

    @cached_property
    def shares(self) -> tuple[Share, ...]:
        """The own rows of nodes of each thread; there are fewer threads where there are few strips."""
        strips, own = self.node_strips, self.own_nodes
        threads = self.threads if self.shape[0] * self.shape[1] >= MIN_SHARED_NODES else 1
        threads = max(1, min(threads, len(strips)))
        ends = [k * len(strips) // threads for k in range(threads + 1)]
        firsts = [own.start, *(strips[end][0] for end in ends[1:-1]), own.stop]
        return tuple(Share(firsts[k], firsts[k + 1], range(ends[k], ends[k + 1])) for k in range(threads))

    def each(self, work: Callable[[Share], T]) -> list[T]:
        """The results of ``work`` for the share of every thread, in the order of the rows, when all are done."""
        if len(self.shares) == 1:
            return [work(self.shares[0])]
        results: dict[int, T] = {}
        run_on_threads(len(self.shares), lambda k: results.update({k: work(self.shares[k])}))
        return [results[k] for k in range(len(self.shares))]

    def largest_here(self, work: Callable[[Share], float]) -> float:
        """The largest number of a share; NaN where one of them is NaN."""
        return work(self.shares[0]) if len(self.shares) == 1 else float(np.max(self.each(work)))


@lru_cache(maxsize=256)
def _whole(n_xi: int, n_eta: int, threads: int) -> Rows:
    return Rows(shape=(n_xi, n_eta), begin=0, end=n_xi, first=0, last=n_xi - 1, threads=threads)
