"""Sums of squared metric lengths along the xi-lines, which run through all strips of rows.

Each strip gives the sum over its own edges. These are added up the tree of :mod:`equimesh.meshes.rows`; the sum over
all gives the mean length of each line; and the running sums with which the lines begin in each strip go down the same
tree.
"""

from __future__ import annotations

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.meshes.rows import Rows, subtree
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray
from equimesh.sweeps import kernels
from equimesh.sweeps.closed_lines import close_lines
from equimesh.sweeps.kernels import Levels, Lines


class LineSums:
    """What the own strips add to the sums along the xi-lines, and where the lines start in each strip.

    ``strips`` and ``starts`` have the shape ``(strips, n_eta)``. ``pushes`` of shape ``(2, n_eta)`` are ``-2 P`` on the
    left and right side, as far as these are here. ``first`` are the squared metric lengths of the first edges
    of the lines, ``levels`` the means and shifts of all lines. ``closings`` of shape ``(strips, 4, n_eta)`` are the
    sums that close the lines, where they are closed.
    """

    def __init__(self, rows: Rows, summed: int, *, closed: bool = False) -> None:
        """Memory for the sums of the edges that begin in the rows of the grid from 1 to ``summed - 1``."""
        n_eta, own = rows.shape[1], len(rows.node_strips)
        self.strips, self.starts = np.empty((own, n_eta)), np.empty((own, n_eta))
        self.first, self.pushes = np.zeros(n_eta), np.zeros((2, n_eta))
        self.levels = Levels(np.ones(n_eta), np.zeros(n_eta))
        self.edges = summed - 1
        self._rows = np.array([first for first, _ in rows.node_strips], dtype=np.int64)
        self._tree = subtree(0, own)
        self.closings = np.empty((own, 4, n_eta)) if closed else None

    def solve(self, lines: Lines) -> float:
        """Find :attr:`levels` and :attr:`starts` from the sums of the strips.

        Returns the largest relative deviation of a first edge from the mean of its line, 0 where these are elsewhere.
        """
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
    ``-2 P`` on the left and right side. ``tree`` has the nodes of :func:`~equimesh.meshes.rows.subtree`, ``rows`` the
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
