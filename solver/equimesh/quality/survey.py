"""One pass over all cells of a mesh: what is measured of each cell, and the errors of interpolating u in it.

The own cells are looked at. The statistics of all strips give those of the mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from equimesh.monitors.monitor import Monitor, OfDerivatives
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array
from equimesh.quality.cell_maps import locate, shapes, shares_and_alignments
from equimesh.quality.cells import BilinearCells, CellPoints, MeshCells, cells_of_block, pieces
from equimesh.quality.tally import ErrorTally, share_blocks

# Compiled means of a metric over cells.
#
# ``corners`` of shape ``(8, n)`` are x and then y of the corners of the cells, counter-clockwise. Functions at points
# have the shape ``(points, n)``.


@compiled
def mean_metrics(
    corners: Array, area: Array, points: CellPoints, metric: tuple[Array, Array, Array], out: Array
) -> None:
    """The mean of ``metric`` over every cell, by quadrature; ``out`` has the shape ``(3, n)``."""
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    s, t, weights = points
    out[:] = 0.0
    first, second, third = out[0], out[1], out[2]
    for p in range(s.size):
        u, v, weight = s[p], t[p], weights[p]
        m11, m12, m22 = metric[0][p], metric[1][p], metric[2][p]
        for k in range(area.size):
            x_s = (1.0 - v) * (x1[k] - x0[k]) + v * (x2[k] - x3[k])
            y_s = (1.0 - v) * (y1[k] - y0[k]) + v * (y2[k] - y3[k])
            x_t = (1.0 - u) * (x3[k] - x0[k]) + u * (x2[k] - x1[k])
            y_t = (1.0 - u) * (y3[k] - y0[k]) + u * (y2[k] - y1[k])
            share = weight * (x_s * y_t - x_t * y_s) / area[k]
            first[k] += share * m11[k]
            second[k] += share * m12[k]
            third[k] += share * m22[k]


@compiled
def nodal_means(corners: Array, metric: tuple[Array, Array, Array], start: int, out: Array) -> None:
    """As :func:`mean_metrics` by the corners of the cells from number ``start`` on of a grid of nodes.

    ``metric`` is that at the nodes, each entry of their shape. A corner counts by the determinant there.
    """
    x0, x1, x2, x3 = corners[0], corners[1], corners[2], corners[3]
    y0, y1, y2, y3 = corners[4], corners[5], corners[6], corners[7]
    first, second, third = metric
    columns, k = first.shape[1] - 1, 0
    a, b, c, d = np.empty(columns), np.empty(columns), np.empty(columns), np.empty(columns)
    while k < out.shape[1]:
        i = (start + k) // columns
        j = start + k - i * columns
        count = min(columns - j, out.shape[1] - k)
        for m in range(count):
            p = k + m
            a[m] = (x1[p] - x0[p]) * (y3[p] - y0[p]) - (y1[p] - y0[p]) * (x3[p] - x0[p])
            b[m] = (x1[p] - x0[p]) * (y2[p] - y1[p]) - (y1[p] - y0[p]) * (x2[p] - x1[p])
            c[m] = (x2[p] - x3[p]) * (y2[p] - y1[p]) - (y2[p] - y3[p]) * (x2[p] - x1[p])
            d[m] = (x2[p] - x3[p]) * (y3[p] - y0[p]) - (y2[p] - y3[p]) * (x3[p] - x0[p])
        for m in range(count):
            per = 1.0 / (a[m] + b[m] + c[m] + d[m])
            a[m], b[m], c[m], d[m] = a[m] * per, b[m] * per, c[m] * per, d[m] * per
        for entry, to in ((first, out[0]), (second, out[1]), (third, out[2])):
            low, high = entry[i], entry[i + 1]
            for m in range(count):
                to[k + m] = a[m] * low[j + m] + b[m] * high[j + m] + c[m] * high[j + m + 1] + d[m] * low[j + m + 1]
        k += count


# Extremes, mean and root mean square of numbers that come in blocks.


class Statistics(NamedTuple):
    """The largest and the smallest of some numbers, their mean and the root of the mean of their squares."""

    max: float
    min: float
    mean: float
    rms: float

    @classmethod
    def of(cls, parts: Array, count: int) -> list[Statistics]:
        """Those of each of some rows of ``count`` numbers, from the :func:`parts <fill_parts>` of their blocks.

        These have the shape ``(blocks, rows, 4)``.
        """
        ends = parts[:, :, 0].max(axis=0).tolist(), parts[:, :, 1].min(axis=0).tolist()
        sums, squares = parts[:, :, 2:].sum(axis=0).T.tolist()
        found = zip(*ends, sums, squares, strict=True)
        return [cls(high, low, total / count, math.sqrt(square / count)) for high, low, total, square in found]

    def times(self, factor: float) -> Statistics:
        """Those of the numbers times a positive ``factor``."""
        return Statistics(*(factor * value for value in self))


def fill_parts(rows: Array, out: Array) -> None:
    """Fill ``out``, of shape ``(rows, 4)``, with the largest and smallest, the sum and the sum of squares of each row.

    Where a number is not finite they are what numpy says.
    """
    rows.max(axis=1, out=out[:, 0])
    rows.min(axis=1, out=out[:, 1])
    fast_sums(rows, out)
    if not math.isfinite(out[:, 3].sum()):
        out[:, 2], out[:, 3] = rows.sum(axis=1), np.square(rows).sum(axis=1)


def join_parts(one: Array, other: Array) -> None:
    """Add to ``one`` the :func:`fill_parts` of other numbers."""
    np.maximum(one[:, 0], other[:, 0], out=one[:, 0])
    np.minimum(one[:, 1], other[:, 1], out=one[:, 1])
    one[:, 2:] += other[:, 2:]


@vectorised
def fast_sums(rows: Array, out: Array) -> None:
    """The sums of :func:`fill_parts` where all numbers are finite; where one is not, that of its squares is neither."""
    for r in range(rows.shape[0]):
        row = rows[r]
        total, squares = 0.0, 0.0
        for k in range(row.size):
            total += row[k]
            squares += row[k] * row[k]
        out[r, 2], out[r, 3] = total, squares


ROWS = ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures that have one value per cell, in the order of the rows of an array of them."""
MAX_KEPT_CELLS = 16_384
"""On at most this many cells all values are kept, since they exist anyway."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """The statistics of all measures, in the order of :data:`ROWS`, and ``q_eq`` of every own cell.

    ``kept`` are all values of the own cells, of shape ``(7, cells)``, or ``None`` where they are not kept. ``nodal`` is
    u at the held nodes around own cells, where the metric was evaluated there and depends on u alone.
    """

    statistics: tuple[Statistics, ...]
    q_eq: Array
    kept: Array | None
    nodal: Array | None

    @classmethod
    def of(
        cls,
        cells: MeshCells,
        monitor: Monitor,
        rule: CellPoints,
        *,
        tally: ErrorTally | None = None,
        threads: int = 1,
        keep: bool = False,
    ) -> Survey:
        """The survey with the metric of ``monitor`` at the points of ``rule``.

        ``tally`` counts the errors of interpolation at the same points, unless these are the corners. ``keep`` keeps
        all values in any case.
        """
        strips, own = cells.rows.strips, cells.own
        kept = np.empty((len(ROWS), own.stop - own.start)) if keep or cells.count <= MAX_KEPT_CELLS else None
        q_eq = np.empty(own.stop - own.start) if kept is None else kept[0]
        parts, shares = np.empty((len(strips), len(ROWS), 4)), np.zeros(len(strips))
        is_valid = cells.all_valid  # before the threads need it
        metrics: _Metrics
        if rule is CellPoints.corners():
            metrics, size = _AtNodes.of(cells, monitor), BLOCK_CELLS
        else:
            metrics, size = _Inside(cells, monitor, rule, tally if is_valid else None), cells_of_block(rule)

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for number in range(thread, len(strips), threads):
                    metrics.begin(number)
                    first, last = strips[number]
                    for block in pieces(first * cells.shape[1], last * cells.shape[1], size):
                        here = _places(cells, block)
                        rows = np.empty((len(ROWS), block.stop - block.start))
                        shares[number] += _measure(cells, metrics, number, block, rows)
                        if block.start == first * cells.shape[1]:
                            fill_parts(rows, parts[number])
                        else:
                            found = np.empty((len(ROWS), 4))
                            fill_parts(rows, found)
                            join_parts(parts[number], found)
                        if kept is None:
                            q_eq[here] = rows[0]
                        else:
                            kept[:, here] = rows
                    metrics.end(number)

        share_blocks(work, own.stop - own.start, threads)
        found = cells.rows.joined(np.column_stack([shares, parts.reshape(len(strips), -1)]))
        with np.errstate(all="ignore"):
            factor = np.float64(cells.count) / found[:, 0].sum()
            q_eq *= factor
        statistics = Statistics.of(found[:, 1:].reshape(-1, len(ROWS), 4), cells.count)
        statistics[0] = statistics[0].times(float(factor))
        return cls(statistics=tuple(statistics), q_eq=q_eq, kept=kept, nodal=metrics.nodal)


def _measure(cells: MeshCells, metrics: _Metrics, strip: int, block: slice, rows: Array) -> float:
    """Fill ``rows`` of the measures of some cells, the first one not yet scaled; returns its sum over valid cells."""
    here = cells.places(block)
    corners, area, valid = cells.corners(block), cells.area[here], cells.valid[here]
    metric = metrics.means(strip, block, corners)
    shares_and_alignments(corners, area, valid, metric, rows[:2])
    shapes(corners, valid, rows[2:6])
    np.arctan(rows[4], out=rows[4])
    rows[4] /= 0.5 * np.pi
    cells.size_ratios(block, rows[6])
    return float(rows[0].sum() if cells.all_valid else rows[0].sum(where=valid))


def _places(cells: MeshCells, block: slice) -> slice:
    return slice(block.start - cells.own.start, block.stop - cells.own.start)


# The mean metric of every cell, by one of two rules: points inside the cells, or their corners.


class _Metrics(Protocol):
    """The mean metrics of the cells of a mesh, strip by strip; threads may ask for those of different strips."""

    @property
    def nodal(self) -> Array | None:
        """u at the held nodes, where it was needed."""
        ...

    def begin(self, strip: int) -> None:
        """What the blocks of a strip share is computed here."""
        ...

    def means(self, strip: int, block: slice, corners: Array) -> Array:
        """The mean metrics of the cells of a block of the strip, shape ``(3, cells)``; their ``corners`` are known."""
        ...

    def end(self, strip: int) -> None:
        """The strip is measured."""
        ...


@dataclass(frozen=True, eq=False)
class _Inside:
    """By points inside every cell, at which ``tally`` counts the errors of interpolation."""

    cells: MeshCells
    monitor: Monitor
    rule: CellPoints
    tally: ErrorTally | None
    nodal: Array | None = None

    def begin(self, strip: int) -> None:
        """Nothing: blocks share no points."""

    def end(self, strip: int) -> None:
        """Nothing is kept."""

    def means(self, strip: int, block: slice, corners: Array) -> Array:  # noqa: ARG002 - as by the corners
        """As the protocol has it."""
        here = self.cells.places(block)
        area, own = self.cells.area[here], _places(self.cells, block)
        if self.cells.all_valid:
            return self._of_valid(corners, area, own)
        metric = np.full((3, area.size), np.nan)  # u need not be defined where a folded cell reaches
        chosen = np.flatnonzero(self.cells.valid[here])
        metric[:, chosen] = self._of_valid(np.ascontiguousarray(corners[:, chosen]), area[chosen], own)
        return metric

    def _of_valid(self, corners: Array, area: Array, own: slice) -> Array:
        rule, monitor, tally = self.rule, self.monitor, self.tally
        x, y = np.empty((2, rule.s.size, area.size))
        locate(corners, rule.s, rule.t, x, y)
        mean = np.empty((3, area.size))
        if tally is not None and isinstance(monitor, OfDerivatives):
            derivatives = tally.u.evaluate(x, y, monitor.order)
            entries = monitor.metric_of(*derivatives)
            tally.add(own, corners, derivatives)
        else:
            entries = monitor.metric(x, y)
            if tally is not None:
                tally.add(own, corners, tally.u.evaluate(x, y, 1))
        mean_metrics(corners, area, rule, contiguous(entries), mean)
        return mean


@dataclass(frozen=True, eq=False)
class _AtNodes:
    """By the corners of every cell, where neighbours share the metric.

    ``strips`` has the metric at the nodes of every strip that is being measured; on blocks at all nodes.
    """

    cells: MeshCells
    monitor: Monitor
    nodal: Array | None
    strips: dict[int, tuple[Array, Array, Array]]

    @classmethod
    def of(cls, cells: MeshCells, monitor: Monitor) -> _AtNodes:
        """Nothing yet; on blocks the metric at all nodes."""
        is_known = isinstance(monitor, OfDerivatives) and monitor.u is not None
        found = cls(cells, monitor, np.full(cells.nodes[0].shape, np.nan) if is_known else None, {})
        if not isinstance(cells, BilinearCells):
            found.strips[ALL] = found._at(*cells.nodes, found.nodal)
        return found

    def begin(self, strip: int) -> None:
        """The metric at the nodes of the strip."""
        if isinstance(self.cells, BilinearCells):
            first, last = self.cells.rows.strips[strip]
            begin, nodal = self.cells.rows.begin, self.nodal
            there = None if nodal is None else nodal[first - begin : last + 1 - begin]
            self.strips[strip] = self._at(*self.cells.window.nodes(first, last), there)

    def end(self, strip: int) -> None:
        """The metric of the strip is needed no more."""
        self.strips.pop(strip, None)

    def means(self, strip: int, block: slice, corners: Array) -> Array:
        """As the protocol has it."""
        mean = np.empty((3, corners.shape[1]))
        if isinstance(self.cells, BilinearCells):
            first = self.cells.rows.strips[strip][0]
            nodal_means(corners, self.strips[strip], block.start - first * self.cells.shape[1], mean)
            return mean
        numbers = np.arange(block.start, block.stop)
        m11, m12, m22 = (self.cells.corner_values(entry, numbers) for entry in self.strips[ALL])
        mean_metrics(corners, self.cells.area[block], CellPoints.corners(), (m11, m12, m22), mean)
        return mean

    def _at(self, x: Array, y: Array, nodal: Array | None) -> tuple[Array, Array, Array]:
        """The metric at these nodes; u there goes to ``nodal``."""
        monitor, u = self.monitor, self.monitor.u
        with np.errstate(all="ignore"):
            if nodal is None or u is None or not isinstance(monitor, OfDerivatives):
                return contiguous(monitor.metric(x, y))
            derivatives = u.evaluate(x, y, monitor.order)
            nodal[...] = derivatives[0]
            return contiguous(monitor.metric_of(*derivatives))


BLOCK_CELLS = 1 << 14
"""Cells of a block where the metric is known at the nodes: a block has no points inside cells."""
ALL = -1
"""The strip of a mesh of blocks, whose nodes are evaluated together."""


def contiguous(entries: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The entries of a metric, as compiled loops read them."""
    m11, m12, m22 = (np.ascontiguousarray(entry, dtype=float) for entry in entries)
    return m11, m12, m22
