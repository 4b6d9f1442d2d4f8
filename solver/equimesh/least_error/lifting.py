"""Meshes of blocks on a finer level: interpolation of the coarser one, and the mending of folds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from equimesh.least_error.block_levels import BlockLevel
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import CurveChart
from equimesh.least_error.kernels import Nodes
from equimesh.meshes.cell_edges import originals_of
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, IntArray

AHEAD = 4
"""Lines from which a value is interpolated with cubic interpolation; two with linear one."""


class Line(NamedTuple):
    """Places between lines, each with the numbers of the lines around it and their weights, shape ``(places, k)``."""

    numbers: IntArray
    weights: Array


class Around(NamedTuple):
    """The nodes of a block with one more line on each side, those of its neighbours, and the places of all lines."""

    nodes: IntArray
    """-1 where there is no neighbour, and at the four corners."""
    places: tuple[Array, Array]
    steps: IntArray
    """By axis and end the finest lines to the neighbour; 0 where there is none."""


class Lifting:
    """Interpolation of values at the nodes of a ``coarse`` level to those of a ``fine`` one."""

    def __init__(self, coarse: BlockLevel, fine: BlockLevel) -> None:
        self.coarse, self.fine = coarse, fine

    @cached_property
    def _alone(self) -> list[Around]:
        """The blocks without neighbours."""
        pairs = zip(self.coarse.blocks, self.coarse.lines, strict=True)
        return [_padded(nodes, lines, np.zeros((2, 2), dtype=np.int64)) for nodes, lines in pairs]

    @cached_property
    def _around(self) -> list[Around]:
        """The blocks with their neighbours."""
        return [_around(self.coarse, block) for block in range(len(self.coarse.blocks))]

    def lifted(self, values: Array, *, cubic: bool, alone: bool = False) -> Array:
        """``values`` of shape ``(k, coarse nodes)`` at the fine nodes, exact at nodes that are both.

        ``alone`` tells whether each block is interpolated without its neighbours: lines may have kinks between them.
        """
        out = np.zeros((len(values), self.fine.points))
        blocks = zip(self._alone if alone else self._around, self.fine.lines, self.fine.blocks, strict=True)
        for around, wanted, to in blocks:
            _lift(values, around, wanted, to, out, cubic=cubic)
        return out

    def lifted_along_sides(self, values: Array, *, cubic: bool) -> Array:
        """See :meth:`lifted`, of one value a node, shape ``(coarse nodes,)``, from values along the same edge alone.

        Inside of blocks the values are 0.
        """
        out = np.zeros((1, self.fine.points))
        blocks = zip(self._alone, self.coarse.lines, self.fine.lines, self.fine.blocks, strict=True)
        for around, lines, wanted, to in blocks:
            for axis in (0, 1):
                # The two edges as a block of two lines.
                nodes = around.nodes[1:-1, 1:-1].take([0, -1], axis)
                ends = [one if k != axis else one[[0, -1]] for k, one in enumerate(lines)]
                there = [one if k != axis else one[[0, -1]] for k, one in enumerate(wanted)]
                edges = _padded(nodes, ends, np.zeros((2, 2), dtype=np.int64))
                _lift(values[None], edges, there, to.take([0, -1], axis), out, cubic=cubic)
        found: Array = out[0]
        return found


def along(values: Array, places: Array) -> Array:
    """``values`` at the nodes of one line, at other ``places`` on it, counted in nodes, by cubic interpolation."""
    line = _line(np.arange(-1.0, values.size + 1.0), np.zeros(2), places, cubic=True)
    found: Array = (values[line.numbers - 1] * line.weights).sum(axis=1)
    return found


def _around(level: BlockLevel, block: int) -> Around:
    """A block of the level with its neighbours."""
    steps, rows = np.zeros((2, 2), dtype=np.int64), dict[tuple[int, int], IntArray]()
    for axis, end in np.ndindex(2, 2):
        other = level.edges.across(block, axis, end)
        if other is None:
            continue
        nodes, lines = level.blocks[other.block], level.lines[other.block][other.axis]
        inner = 1 if other.end == 0 else -2
        row = nodes[inner] if other.axis == 0 else nodes[:, inner]
        rows[axis, end] = row[::-1] if other.is_turned else row
        steps[axis, end] = abs(int(lines[inner] - lines[-other.end]))
    found = _padded(level.blocks[block], level.lines[block], steps)
    for (axis, end), row in rows.items():
        (found.nodes if axis == 0 else found.nodes.T)[-end, 1:-1] = row
    return found


def _padded(nodes: IntArray, lines: Sequence[IntArray], steps: IntArray) -> Around:
    """The nodes of a block and the places of its lines, with those of the neighbours at so many ``steps``."""
    padded = np.full((nodes.shape[0] + 2, nodes.shape[1] + 2), -1)
    padded[1:-1, 1:-1] = nodes
    i, j = (
        np.concatenate([[one[0] - (before or 1.0)], one, [one[-1] + (after or 1.0)]])
        for one, (before, after) in zip(lines, steps.tolist(), strict=True)
    )
    return Around(padded, (i, j), steps)


def _line(places: Array, steps: Array | IntArray, wanted: Array | IntArray, *, cubic: bool) -> Line:
    """Lagrange interpolation from the lines around each of the ``wanted`` places; without ``steps`` no neighbours."""
    first, last = (0 if steps[0] else 1), places.size - (0 if steps[1] else 1)
    size = min(AHEAD, last - first) if cubic else 2
    line = Line(numbers=np.empty((wanted.size, size), dtype=np.int64), weights=np.empty((wanted.size, size)))
    bounds = (first, last - size) if cubic else (1, places.size - 3)
    interpolate(places, np.asarray(wanted, dtype=np.float64), bounds, line.numbers, line.weights)
    return line


def _lift(
    values: Array, around: Around, wanted: Sequence[Array | IntArray], to: IntArray, out: Array, *, cubic: bool
) -> None:
    """Fill ``values`` at the nodes ``to`` of a block, on the ``wanted`` lines: along i, then along j."""
    (places, across), steps = around.places, around.steps
    rows, columns = (
        _line(one, ends, there, cubic=cubic) for one, ends, there in zip(around.places, steps, wanted, strict=True)
    )
    # Lines of a neighbour need not run on as those of the block do.
    beside = _line(places, np.zeros(2), wanted[0], cubic=cubic) if steps[1].any() else rows
    used = np.zeros(across.size, dtype=bool)
    used[columns.numbers] = True
    apply(values, around.nodes, rows, beside, columns, used, to, out)


@compiled
def interpolate(places: Array, wanted: Array, bounds: tuple[int, int], numbers: IntArray, weights: Array) -> None:
    """Fill the numbers of the lines at ``places`` around each of the ``wanted`` ones, and their Lagrange weights.

    ``bounds`` are the smallest and the largest number of a first line. The first and the last line of all have no
    place beyond.
    """
    size = numbers.shape[1]
    for p in range(wanted.size):
        left = min(max(np.searchsorted(places, wanted[p], side="right") - 1, 1), places.size - 3)
        start = min(max(left - (size // 2 - 1), bounds[0]), bounds[1])
        for k in range(size):
            numbers[p, k], weight = start + k, 1.0
            for other in range(size):
                if other != k:
                    weight *= (wanted[p] - places[start + other]) / (places[start + k] - places[start + other])
            weights[p, k] = weight


@compiled
def apply(
    values: Array,
    nodes: IntArray,
    rows: Line,
    beside: Line,
    columns: Line,
    used: BoolArray,
    to: IntArray,
    out: Array,
) -> None:
    """Weighted sums over ``rows`` of ``values`` at ``nodes``, in the columns that are ``used``, then over ``columns``.

    The first and the last column have those ``beside`` them for rows. The results are ``out``, at the numbers ``to``.
    """
    last = used.size - 1
    first = np.empty(used.size)
    for part in range(values.shape[0]):
        for p in range(to.shape[0]):
            for j in range(used.size):
                if used[j]:
                    numbers, weights = rows if 0 < j < last else beside
                    total = 0.0
                    for k in range(numbers.shape[1]):
                        total += weights[p, k] * values[part, nodes[numbers[p, k], j]]
                    first[j] = total
            for q in range(to.shape[1]):
                total = 0.0
                for k in range(columns.numbers.shape[1]):
                    total += columns.weights[q, k] * first[columns.numbers[q, k]]
                out[part, to[p, q]] = total


# Folds of a mesh that comes from a coarser one, mended: nodes of folded corners move as little as unfolds them.
#
# The Jacobian of a corner is linear in each of its nodes. These move along its derivatives, until it has a small
# positive value, one corner after the other: the projections of S. Kaczmarz (1937). Thin cells beside a wall need
# small moves only, and their neighbours mostly stay valid. The rest of the mesh stays as it is.
#
# Where folds remain even so, displacements of the nodes around them are averaged instead. A cell whose nodes are all
# displaced by the same vector has the shape that it has in the first mesh. So where the displacements of neighbours
# become more alike, folds vanish. In thin cells more of them can arise.

SMALLEST_SHARE = 1e-2
"""Cells with a corner whose Jacobian is a smaller share of that of the first mesh are mended."""
MENDED_SHARE = 1.5e-2
"""The share of a corner whose nodes have moved along its derivatives."""
MAX_ROUNDS = 60
"""Most rounds of one kind of mending."""
ROUNDS_OF_MEANS = 10
"""Rounds after which the displacements are shortened, too: beside a bent curve equal ones can fold."""
SHORTENING = 0.8
"""The factor by which they are shortened in a round."""


class Round(NamedTuple):
    """What mending sees: nodes at ``start`` and now, and numbers of the cells that can be folded."""

    cells: Cells
    start: Array
    at: Array
    to: Array
    """As ``at``: where the nodes of small corners are moved."""
    free: Array
    """0 for fixed nodes, 1 for others."""
    looked_at: IntArray
    done: int
    """Rounds before this one."""


Mend: TypeAlias = Callable[[Round], tuple[IntArray, Array]]
"""The nodes that move in a round, and their moves, shape ``(2, nodes)``."""


def mended(chart: CurveChart, cells: Cells, first: Array, mesh: Array) -> Array:
    """The ``mesh`` with fewer folds, mostly with none; both are unknowns of the ``chart``, shape ``(2, nodes)``.

    Nodes of curves move along these. ``first`` is a valid mesh.
    """
    for mend in (_projected, _averaged):
        out, is_mended = _rounds(chart, cells, first, mesh, mend)
        if is_mended:
            break
    return out


def _rounds(chart: CurveChart, cells: Cells, first: Array, mesh: Array, mend: Mend) -> tuple[Array, bool]:
    """The mesh after rounds of mending, and whether it has no folds."""
    start, at = np.stack(chart.nodes(first)), np.stack(chart.nodes(mesh))
    step, to, out, looked_at = np.zeros_like(mesh), at.copy(), mesh, np.arange(cells.count)
    for done in range(MAX_ROUNDS):
        nodes, moves = mend(Round(cells, start, at, to, chart.free[0], looked_at, done))
        if not nodes.size:
            return out, True
        here, now = chart.on(nodes), out[:, nodes]
        step[:, nodes] = here.pulled(now, moves)
        cells.tie(step)
        out = mesh.copy() if out is mesh else out
        now += step[:, nodes]
        out[:, nodes] = now
        at[:, nodes] = to[:, nodes] = here.nodes(now)
        looked_at = _cells_of(nodes, cells)  # other cells are as they were
    return out, False


def _projected(now: Round) -> tuple[IntArray, Array]:
    """The nodes of small corners, and moves along the derivatives of these; see :func:`unfold`."""
    cells, to, marks = now.cells, now.to, np.zeros(now.at.shape[1], dtype=np.bool_)
    unfold(Nodes(to[0], to[1], cells.corners.reshape(-1)), now.start, now.looked_at, now.free, marks)
    nodes = _with_ties(np.flatnonzero(marks), cells)
    if cells.ties.size:
        moves = to - now.at
        np.add.at(moves.T, cells.ties[:, 1], moves.T[cells.ties[:, 0]])  # what a copy needs, its original does
        return nodes, moves[:, nodes]
    return nodes, to[:, nodes] - now.at[:, nodes]


def _averaged(now: Round) -> tuple[IntArray, Array]:
    """The nodes of cells with small corners, and moves to the means of displacements; see :func:`average`."""
    cells, marks = now.cells, np.zeros(now.at.shape[1], dtype=np.bool_)
    mark_folds(Nodes(now.at[0], now.at[1], cells.corners.reshape(-1)), now.start, now.looked_at, SMALLEST_SHARE, marks)
    nodes = _with_ties(np.flatnonzero(marks), cells)
    share = 1.0 if now.done < ROUNDS_OF_MEANS else SHORTENING
    means = average(now.at, now.start, cells.corners, (cells.starts, cells.places), nodes)
    return nodes, share * means - (now.at[:, nodes] - now.start[:, nodes])


def _with_ties(nodes: IntArray, cells: Cells) -> IntArray:
    """The nodes, and those that move with them."""
    if not cells.ties.size or not nodes.size:
        return nodes
    own = originals_of(cells.nodes, cells.ties)
    return np.flatnonzero(np.isin(own, own[nodes]))


def _cells_of(nodes: IntArray, cells: Cells) -> IntArray:
    """The numbers of the cells that have one of the nodes."""
    first, count = cells.starts[nodes], cells.starts[nodes + 1] - cells.starts[nodes]
    places = np.repeat(first - np.cumsum(count) + count, count) + np.arange(int(count.sum()))
    is_near = np.zeros(cells.count, dtype=bool)
    is_near[cells.places[places] // 4] = True
    return np.flatnonzero(is_near)


@compiled
def unfold(nodes: Nodes, start: Array, numbers: IntArray, free: Array, marks: BoolArray) -> None:
    """Move the nodes of small corners of the cells with these ``numbers``, in place, and mark these nodes.

    The Jacobian of such a corner is at most ``SMALLEST_SHARE`` of that at ``start``, which are x and y of the nodes,
    shape ``(2, nodes)``. ``free`` is 0 for nodes that are fixed and 1 for the others.
    """
    x, y, corners = nodes
    for cell in numbers:
        for k in range(4):
            p, n, m = corners[4 * cell + k], corners[4 * cell + (k + 1) % 4], corners[4 * cell + (k + 3) % 4]
            before = (start[0, n] - start[0, p]) * (start[1, m] - start[1, p])
            before -= (start[1, n] - start[1, p]) * (start[0, m] - start[0, p])
            ax, ay, bx, by = x[n] - x[p], y[n] - y[p], x[m] - x[p], y[m] - y[p]
            now = ax * by - ay * bx
            if now > SMALLEST_SHARE * before:
                continue
            # The derivatives of the Jacobian by the three nodes.
            gp, hp = (ay - by) * free[p], (bx - ax) * free[p]
            gn, hn, gm, hm = by * free[n], -bx * free[n], -ay * free[m], ax * free[m]
            size = gp * gp + hp * hp + gn * gn + hn * hn + gm * gm + hm * hm
            if size > 0.0:
                length = (MENDED_SHARE * before - now) / size
                x[p], y[p] = x[p] + length * gp, y[p] + length * hp
                x[n], y[n] = x[n] + length * gn, y[n] + length * hn
                x[m], y[m] = x[m] + length * gm, y[m] + length * hm
                marks[p] = marks[n] = marks[m] = True


@compiled
def mark_folds(nodes: Nodes, start: Array, numbers: IntArray, least: float, marks: BoolArray) -> None:
    """Mark the nodes of those of the cells with these ``numbers`` that have a small corner.

    Its Jacobian is at most ``least`` times that at ``start``, which are x and y of the nodes, shape ``(2, nodes)``.
    """
    x, y, corners = nodes
    for cell in numbers:
        is_bad = False
        for k in range(4):
            p, n, m = corners[4 * cell + k], corners[4 * cell + (k + 1) % 4], corners[4 * cell + (k + 3) % 4]
            before = (start[0, n] - start[0, p]) * (start[1, m] - start[1, p])
            before -= (start[1, n] - start[1, p]) * (start[0, m] - start[0, p])
            now = (x[n] - x[p]) * (y[m] - y[p]) - (y[n] - y[p]) * (x[m] - x[p])
            is_bad = is_bad or not now > least * before
        if is_bad:
            for k in range(4):
                marks[corners[4 * cell + k]] = True


@compiled
def average(at: Array, start: Array, corners: IntArray, around: tuple[IntArray, IntArray], nodes: IntArray) -> Array:
    """The means of the displacements of each of these ``nodes`` and of its neighbours, shape ``(2, nodes)``.

    Displacements are those from ``start`` to ``at``, both of shape ``(2, all nodes)``. ``around`` are the places of the
    nodes in the ``corners`` of cells: where the entries of each node begin, and these. A neighbour counts once for
    every cell that it shares an edge with the node in.
    """
    starts, places = around
    out = np.empty((2, nodes.size))
    for number, node in enumerate(nodes):
        a, b, count = at[0, node] - start[0, node], at[1, node] - start[1, node], 1
        for place in places[starts[node] : starts[node + 1]]:
            cell, k = divmod(place, 4)
            for other in (corners[cell, (k + 1) % 4], corners[cell, (k + 3) % 4]):
                a += at[0, other] - start[0, other]
                b += at[1, other] - start[1, other]
                count += 1
        out[0, number], out[1, number] = a / count, b / count
    return out
