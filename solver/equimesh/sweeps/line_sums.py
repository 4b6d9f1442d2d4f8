"""Sums of squared metric lengths along the xi-lines, which run through all strips of rows.

Each strip gives the sum over its own edges. These are added up the tree of :mod:`equimesh.meshes.parts`; the sum over
all gives the mean length of each line; and the running sums with which the lines begin in each strip go down the same
tree. Processes that hold different strips do the part of it that lies inside their own ones, and send each other the
sums and starts of the nodes that lie across their cuts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.parts import Node, Parts, cuts_of, nodes_across, nodes_inside, strips_of, subtree
from equimesh.numerics.channel import Channel, joined
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.sweeps import kernels
from equimesh.sweeps.kernels import Levels, Lines, close_lines


class LineSums:
    """What the strips of a process add to the sums along the xi-lines, and where the lines start in each strip.

    ``strips`` and ``starts`` have the shape ``(strips, n_eta)``. ``pushes`` of shape ``(2, n_eta)`` are ``-2 P`` on the
    left and right side, as far as the process holds these. ``first`` are the squared metric lengths of the first edges
    of the lines, ``levels`` the means and shifts of all lines. ``closings`` of shape ``(strips, 4, n_eta)`` are the
    sums that close the lines, where they are closed.
    """

    def __init__(self, parts: Parts, summed: int, *, closed: bool = False) -> None:
        """Memory for the sums of the edges that begin in the rows of the grid from 1 to ``summed - 1``."""
        n_eta, own = parts.shape[1], parts.own.strips
        self.strips, self.starts = np.empty((len(own), n_eta)), np.empty((len(own), n_eta))
        self.first, self.pushes = np.zeros(n_eta), np.zeros((2, n_eta))
        self.levels = Levels(np.ones(n_eta), np.zeros(n_eta))
        self.edges = summed - 1
        self._rows = np.array([first for first, _ in parts.strips], dtype=np.int64)
        self._tree = subtree(0, len(own))
        self._across = None if parts.is_whole else _Across(parts)
        self.closings = np.empty((len(own), 4, n_eta)) if closed else None

    def solve(self, lines: Lines) -> float:
        """Find :attr:`levels` and :attr:`starts` from the sums of the strips, of all processes.

        Returns the largest relative deviation of a first edge from the mean of its line, 0 where another process holds
        these.
        """
        if self._across is not None:
            return self._across.solve(self, lines)
        found = line_sums(
            self.first,
            self.strips,
            self._tree,
            self._rows,
            self.pushes,
            lines,
            self.edges,
            self.levels,
            self.starts,
        )
        if self.closings is not None:
            close_lines(self.closings, self.levels, self.starts)
        return found


class _Cut(NamedTuple):
    """A node that lies in more than one part: the part that adds its sum, and the part that adds its second half's.

    ``levels_first`` tells whether the start of the second half is the first thing that the latter part gets to know.
    """

    node: Node
    owner: int
    right_owner: int
    levels_first: bool


class _Across:
    """The sums and starts of the nodes of the tree that lie across the cuts between processes.

    The owner of a node is the process that holds its first strip.
    """

    def __init__(self, parts: Parts) -> None:
        strips = strips_of(parts.shape)
        cuts, own = cuts_of(len(strips), parts.channel.count), parts.own.strips
        self._channel, self._offset = parts.channel, own.start
        self._inside = nodes_inside(len(strips), own.start, own.stop)
        self._trees = [subtree(node.first - own.start, node.last - own.start) for node in self._inside]
        self._first_rows = [first for first, _ in strips]
        self._rows = np.array(self._first_rows[own.start : own.stop], dtype=np.int64)
        self._root, self._last = (0, len(strips)), parts.channel.count - 1
        self._cuts = [cut for cut in _cuts(len(strips), cuts) if self._channel.number in (cut.owner, cut.right_owner)]

    def solve(self, sums: LineSums, lines: Lines) -> float:
        """As :meth:`LineSums.solve`."""
        deviation, number = 0.0, self._channel.number
        known = self._up(sums)
        if number == self._last:
            self._channel.send(0, "push", [sums.pushes[1]])
        starts = dict[tuple[int, int], Array]()
        if number == 0:
            (sums.pushes[1],) = self._channel.receive(self._last, "push")
            starts[self._root] = np.empty_like(sums.first)
            deviation = line_levels(
                sums.first, known[self._root], sums.pushes, lines, sums.edges, sums.levels, starts[self._root]
            )
        self._down(sums, known, starts)
        return deviation

    def _up(self, sums: LineSums) -> dict[tuple[int, int], Array]:
        """The sums of the nodes that this process owns, and of their halves."""
        known = dict[tuple[int, int], Array]()
        for node, tree in zip(self._inside, self._trees, strict=True):
            add_up(sums.strips, tree)
            known[node.first, node.last] = sums.strips[node.last - 1 - self._offset]
        for (first, middle, last), owner, right_owner, _ in reversed(self._cuts):
            if owner != self._channel.number:
                self._channel.send(owner, "sums", [known[middle, last]])
                continue
            if right_owner != owner:
                (known[middle, last],) = self._channel.receive(right_owner, "sums")
            known[first, last] = known[first, middle] + known[middle, last]
        return known

    def _down(self, sums: LineSums, known: dict[tuple[int, int], Array], starts: dict[tuple[int, int], Array]) -> None:
        """The starts of all strips of this process, from that of the root; the levels come with the first of them."""
        for (first, middle, last), owner, right_owner, levels_first in self._cuts:
            if owner == self._channel.number:
                starts[first, middle] = start = starts[first, last]
                after = np.empty_like(start)
                rows = self._first_rows[middle] - self._first_rows[first]
                start_after(start, known[first, middle], rows, sums.levels, after)
                if right_owner == owner:
                    starts[middle, last] = after
                else:
                    self._channel.send(right_owner, "starts", [*(sums.levels if levels_first else ()), after])
            else:
                *levels, starts[middle, last] = self._channel.receive(owner, "starts")
                for mine, received in zip(sums.levels, levels, strict=False):
                    mine[:] = received
        for node, tree in zip(self._inside, self._trees, strict=True):
            sums.starts[node.first - self._offset] = starts[node.first, node.last]
            go_down(sums.strips, tree, self._rows, sums.levels, sums.starts)


def _cuts(strips: int, cuts: tuple[int, ...]) -> Iterator[_Cut]:
    """All nodes across the ``cuts``, with their owners, each before the nodes inside it."""
    owners = np.searchsorted(cuts, np.arange(strips), side="right") - 1
    told = {0}
    for node in nodes_across(strips, cuts):
        owner, right_owner = int(owners[node.first]), int(owners[node.middle])
        yield _Cut(node, owner, right_owner, right_owner not in told)
        told.add(right_owner)


@compiled
def line_sums(
    first: Array,
    sums: Array,
    tree: IntArray,
    rows: IntArray,
    pushes: Array,
    lines: Lines,
    edges: int,
    levels: Levels,
    starts: Array,
) -> float:
    """Prepare the corrections of the xi-lines strip by strip, from the sums of each strip of rows.

    ``first`` holds the squared metric lengths of the first edges, which belong to lines from node 0, ``sums`` of shape
    ``(strips, n_eta)`` those summed over the edges of each strip, ``edges`` in all, ``pushes`` of shape ``(2, n_eta)``
    ``-2 P`` on the left and right side. ``tree`` has the nodes of :func:`~equimesh.meshes.parts.subtree`, ``rows`` the
    first row of each strip. Fills in ``levels`` and, in ``starts``, the ``running`` of
    :func:`~equimesh.sweeps.kernels.xi_corrections` for every strip. Returns the largest relative deviation of a first
    edge.
    """
    add_up(sums, tree)
    deviation = line_levels(first, sums[-1], pushes, lines, edges, levels, starts[0])
    go_down(sums, tree, rows, levels, starts)
    return deviation


@compiled
def add_up(sums: Array, tree: IntArray) -> None:
    """Add the sums of the strips, in place: the sum of a node then stands at its last strip.

    The sum of the first half of every node stays where it is.
    """
    for k in range(tree.shape[0] - 1, -1, -1):
        left, right = sums[tree[k, 1] - 1], sums[tree[k, 2] - 1]
        for j in range(right.size):
            right[j] = left[j] + right[j]


@compiled
def line_levels(
    first: Array, sums: Array, pushes: Array, lines: Lines, edges: int, levels: Levels, start: Array
) -> float:
    """The ``levels`` of the xi-lines, and their ``start`` in the first strip, from the ``sums`` over all strips.

    Otherwise as :func:`line_sums`.
    """
    has_first, rest, beyond = lines.first == 0, lines.rest, lines.beyond
    mean, shift = levels
    count = beyond[0] + beyond[1] + edges
    if has_first:
        count += 1
    deviation = 0.0
    for j in range(1, sums.size - 1):
        total = rest[0, j] + rest[1, j]
        if has_first:
            total += first[j]
        total += sums[j]
        mean[j], shift[j] = total / count, (pushes[1, j] - pushes[0, j]) / count
        start[j] = pushes[0, j] + rest[0, j] - beyond[0] * (mean[j] - shift[j])
        if has_first:
            start[j] += first[j] - mean[j] + shift[j]
            deviation = max(deviation, abs(first[j] - mean[j]) / mean[j])
        if total - total != 0.0:
            deviation = np.inf
    return deviation


@compiled
def go_down(sums: Array, tree: IntArray, rows: IntArray, levels: Levels, starts: Array) -> None:
    """The ``starts`` of all strips of a node from that of its first strip; ``sums`` as :func:`add_up` leaves them."""
    for k in range(tree.shape[0]):
        first, middle = tree[k, 0], tree[k, 1]
        start_after(starts[first], sums[middle - 1], rows[middle] - rows[first], levels, starts[middle])


@compiled
def start_after(start: Array, sums: Array, rows: int, levels: Levels, after: Array) -> None:
    """The start of the lines ``rows`` rows after ``start``, the squared metric lengths between having these sums."""
    mean, shift = levels
    for j in range(1, sums.size - 1):
        after[j] = start[j] + (sums[j] + rows * (shift[j] - mean[j]))


# The sum, the largest and the smallest of the edges of every xi-line, from processes that hold some of its rows.
#
# Sums are added up the tree of :mod:`equimesh.meshes.parts`: they do not depend on the number of processes, to the
# last bit. Each process sends one message, with the sums of a few nodes of the tree.

TAG = "lines"
"""The tag of the messages."""


def line_extremes(channel: Channel, strips: Array) -> Array | None:
    """The sums, the largest and the smallest numbers of all strips, of shape ``(3, n)``, in the first process.

    ``strips`` of shape ``(strips, 3, n)`` are those of the own strips. The other processes get ``None``.
    """
    counts = joined(channel, np.array([float(len(strips))])).astype(np.int64)
    ends, number = [0, *np.cumsum(counts).tolist()], channel.number
    whole, first = ends[-1], ends[number]
    known = {(first + k, first + k + 1): strip for k, strip in enumerate(strips[:, 0])}
    high, low = strips[:, 1].max(axis=0, initial=-np.inf), strips[:, 2].min(axis=0, initial=np.inf)
    step = 1
    while step < channel.count:
        last = ends[min(number + step, channel.count)]
        if number % (2 * step):
            sums = [_sum(known, node) for node in nodes_inside(whole, first, last)]
            channel.send(number - step, TAG, [*sums, high, low])
            return None
        if number + step < channel.count:
            *sums, others_high, others_low = channel.receive(number + step, TAG)
            nodes = nodes_inside(whole, last, ends[min(number + 2 * step, channel.count)])
            known |= _by_ends(nodes, sums)
            high, low = np.maximum(high, others_high), np.minimum(low, others_low)
        step *= 2
    return np.stack([_sum(known, Node.of(0, whole)), high, low])


def _by_ends(nodes: Iterable[Node], sums: Iterable[Array]) -> dict[tuple[int, int], Array]:
    return {(node.first, node.last): found for node, found in zip(nodes, sums, strict=True)}


def _sum(known: dict[tuple[int, int], Array], node: Node) -> Array:
    """The sum of a node, from the ``known`` ones inside."""
    found = known.get((node.first, node.last))
    if found is not None:
        return found
    return _sum(known, Node.of(node.first, node.middle)) + _sum(known, Node.of(node.middle, node.last))


# The metric of the cells between rows of nodes.

# Numbers that are left free on either side of the metric of cells, besides two rows of it.
MARGIN = 4_096


def cell_memory(rows: int, n_eta: int) -> Array:
    """Memory for the metric of ``rows`` rows of cells, shape ``(3, rows, n_eta - 1)``, apart from all other memory.

    A compiled loop looks whether its arrays may overlap, and then takes another way, which rounds differently. Where an
    array begins right behind another one it takes them for overlapping. So the last bit of a mesh would depend on where
    the memory happens to lie.
    """
    size, margin = 3 * rows * (n_eta - 1), MARGIN + 2 * n_eta
    return np.empty(size + 2 * margin)[margin : margin + size].reshape(3, rows, n_eta - 1)


def cell_metrics(metric: ReferenceMetric, s: Array, t: Array, cells: Array, u: Array | None = None) -> None:
    """The metric of the cells between rows of nodes, in ``cells`` of shape ``(3, rows - 1, n_eta - 1)``.

    ``u`` is given at the nodes where it is known.
    """
    arc_length = metric.arc_length
    if arc_length is not None and metric.on_unit_square:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells(s, t, u, arc_length.a**2, arc_length.b, cells)
        return
    cells[0], cells[1], cells[2] = metric.base(centres(s), centres(t))
    if arc_length is not None:
        u = metric.u(s, t) if u is None else u
        kernels.arc_length_cells_on(s, t, u, arc_length.a**2, arc_length.b, cells)


def centres(q: Array) -> Array:
    return np.asarray(0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]))
