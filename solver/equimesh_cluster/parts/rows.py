"""The rows of a grid that one of several processes has: how they are cut, and what the processes tell each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise

import numpy as np

from equimesh.errors import InputError
from equimesh.meshes.mesh import MeshRows
from equimesh.meshes.rows import Node, Rows, strips_of, sum_of
from equimesh.numerics.types import Array
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.messages import Channel, agree, joined, summed

# How rows are cut among processes: at nodes of the tree over the strips, in which sums are added.

# Parts whose number is no power of two are cut at nodes that are deeper in the tree by so much: their sizes are then
# nearly equal, and few sums travel.
EXTRA_DEPTH = 2


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


def row_cuts(shape: tuple[int, int], count: int) -> tuple[int, ...]:
    """The first row of each of ``count`` processes, and the number of rows."""
    strips = strips_of(shape)
    if count == 1:
        return 0, shape[0]
    return 0, *(strips[cut][0] for cut in cuts_of(len(strips), count)[1:-1]), shape[0]


def rows_here(shape: tuple[int, int], count: int) -> list[tuple[int, int]]:
    """The first row that each of ``count`` processes has, and the one after the last."""
    return with_halos(row_cuts(shape, count))


def with_halos(cuts: Sequence[int]) -> list[tuple[int, int]]:
    """The rows between ``cuts``, of which the last is the number of rows, and one more each way where there is one."""
    return [(max(first - 1, 0), min(last + 1, cuts[-1])) for first, last in pairwise(cuts)]


@dataclass(frozen=True, kw_only=True)
class PartRows(Rows):
    """The rows of one process; the ``channel`` leads to the others, which call the same methods in the same order."""

    channel: Channel = field(repr=False)

    @classmethod
    def of(cls, shape: tuple[int, ...], threads: int, channel: Channel) -> PartRows:
        """The own rows of part ``channel.number`` of ``channel.count``, and one more each way where there is one.

        Raises :class:`~equimesh.errors.InputError` where the grid has too few rows for so many parts.
        """
        size, number, count = (shape[0], shape[1]), channel.number, channel.count
        first, last = row_cuts(size, count)[number : number + 2]
        begin, end = rows_here(size, count)[number]
        last = min(last, size[0] - 1)
        return cls(shape=size, begin=begin, end=end, first=first, last=last, threads=threads, channel=channel)

    @property
    def are_all(self) -> bool:
        """Whether there is no other process."""
        return self.channel.count == 1

    def joined(self, found: Array) -> Array:
        """What all processes have found, along the first axis in their order."""
        return joined(self.channel, found)

    def summed(self, found: Array) -> Array:
        """The sum of what all processes have found."""
        return summed(self.channel, found)

    def agreed(self, *numbers: float) -> tuple[float, ...]:
        """The largest of each number, of all processes; NaN where one of them is NaN."""
        return numbers if self.are_all else agree(self.channel, *numbers)

    def fill_halos(self, *held: Array) -> None:
        """Take the rows next to the own ones from the processes that own them, for arrays of the rows that are here.

        Each process sends its first own row to the part before it, and its last one to the part after it.
        """
        own, before, after = self.own_nodes, self.channel.number - 1, self.channel.number + 1
        if before >= 0:
            self.channel.send(before, "halo", [array[own.start] for array in held])
        if after < self.channel.count:
            self.channel.send(after, "halo", [array[own.stop - 1] for array in held])
        if before >= 0:
            for array, row in zip(held, self.channel.receive(before, "halo"), strict=True):
                array[own.start - 1] = row
        if after < self.channel.count:
            for array, row in zip(held, self.channel.receive(after, "halo"), strict=True):
                array[own.stop] = row

    def over_lines(self, strips: Array) -> Array | None:
        """The sums, the largest and the smallest numbers of all strips, in the first process; ``None`` in the others.

        Sums are added up the tree: they do not depend on the number of processes, to the last bit. Each process sends
        one message, with the sums of a few nodes of the tree.
        """
        channel = self.channel
        counts = joined(channel, np.array([float(len(strips))])).astype(np.int64)
        ends, number = [0, *np.cumsum(counts).tolist()], channel.number
        whole, first = ends[-1], ends[number]
        known = {(first + k, first + k + 1): strip for k, strip in enumerate(strips[:, 0])}
        high, low = strips[:, 1].max(axis=0, initial=-np.inf), strips[:, 2].min(axis=0, initial=np.inf)
        step = 1
        while step < channel.count:
            last = ends[min(number + step, channel.count)]
            if number % (2 * step):
                sums = [sum_of(node, known) for node in nodes_inside(whole, first, last)]
                channel.send(number - step, "lines", [*sums, high, low])
                return None
            if number + step < channel.count:
                *sums, others_high, others_low = channel.receive(number + step, "lines")
                nodes = nodes_inside(whole, last, ends[min(number + 2 * step, channel.count)])
                known |= _by_ends(nodes, sums)
                high, low = np.maximum(high, others_high), np.minimum(low, others_low)
            step *= 2
        return np.stack([sum_of(Node.of(0, whole), known), high, low])


def rows_of_part(part: MeshPart, channel: Channel) -> MeshRows:
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
    shape, end = part.grid.shape, begin + len(x)
    return MeshRows(x, y, PartRows(shape=shape, begin=begin, end=end, first=first, last=last, channel=channel))


def _by_ends(nodes: Iterable[Node], sums: Iterable[Array]) -> dict[tuple[int, int], Array]:
    return {(node.first, node.last): found for node, found in zip(nodes, sums, strict=True)}
