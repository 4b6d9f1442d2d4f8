"""One pass over all cells of a mesh: what is measured of each cell, and the errors of interpolating u in it.

The own cells are looked at. The statistics of all strips give those of the mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from equimesh.monitors.monitor import Monitor, OfDerivatives
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cell_maps import (
    gather_corners,
    gather_row_of_cells,
    locate,
    shapes,
    shares_and_alignments,
    size_ratios,
    size_ratios_of,
)
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
def nodal_means(x: Array, y: Array, metric: tuple[Array, Array, Array], out: Array) -> None:
    """As :func:`mean_metrics` by the corners of all cells of a grid of nodes, in their order.

    ``metric`` is that at the nodes, each entry of their shape. A corner counts by the determinant there.
    """
    first, second, third = metric
    columns = x.shape[1] - 1
    a, b, c, d = np.empty(columns), np.empty(columns), np.empty(columns), np.empty(columns)
    for i in range(x.shape[0] - 1):
        x0, x1, y0, y1 = x[i], x[i + 1], y[i], y[i + 1]
        for j in range(columns):
            ex0, ey0, ex1, ey1 = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
            fx0, fy0, fx1, fy1 = x0[j + 1] - x0[j], y0[j + 1] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
            a[j], b[j] = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
            c[j], d[j] = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
        for j in range(columns):
            per = 1.0 / (a[j] + b[j] + c[j] + d[j])
            a[j], b[j], c[j], d[j] = a[j] * per, b[j] * per, c[j] * per, d[j] * per
        for entry, to in ((first, out[0]), (second, out[1]), (third, out[2])):
            low, high, here = entry[i], entry[i + 1], to[i * columns : (i + 1) * columns]
            for j in range(columns):
                here[j] = a[j] * low[j] + b[j] * high[j] + c[j] * high[j + 1] + d[j] * low[j + 1]


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


@compiled
def fill_parts(rows: Array, out: Array) -> None:
    """Fill ``out``, of shape ``(rows, 4)``, with the largest and smallest, the sum and the sum of squares of each row.

    Where a number is not finite they are what numpy says.
    """
    fast_parts(rows, out)
    for r in range(rows.shape[0]):
        if not np.isfinite(out[r, 3]):
            out[r] = -np.inf, np.inf, 0.0, 0.0
            for number in rows[r]:
                out[r, 0] = number if number > out[r, 0] or number != number else out[r, 0]
                out[r, 1] = number if number < out[r, 1] or number != number else out[r, 1]
                out[r, 2] += number
                out[r, 3] += number * number


@compiled
def join_parts(one: Array, other: Array) -> None:
    """Add to ``one`` the :func:`fill_parts` of other numbers."""
    for r in range(len(one)):
        high, low = other[r, 0], other[r, 1]
        one[r, 0] = high if high > one[r, 0] or high != high else one[r, 0]
        one[r, 1] = low if low < one[r, 1] or low != low else one[r, 1]
        one[r, 2] += other[r, 2]
        one[r, 3] += other[r, 3]


@vectorised
def fast_parts(rows: Array, out: Array) -> None:
    """:func:`fill_parts` where all numbers are finite; where one is not, the sum of their squares is neither.

    Each comparison waits for the one before it: extremes are found of every fourth number, and then of the four.
    """
    fours = rows.shape[1] // 4 * 4
    for r in range(rows.shape[0]):
        row = rows[r]
        a = b = c = d = e = f = g = h = row[0]
        total, squares = 0.0, 0.0
        for k in range(0, fours, 4):
            p, q, s, t = row[k], row[k + 1], row[k + 2], row[k + 3]
            a, b, c, d = p if p > a else a, q if q > b else b, s if s > c else c, t if t > d else d
            e, f, g, h = p if p < e else e, q if q < f else f, s if s < g else g, t if t < h else h
        for k in range(fours, row.size):
            a, e = max(a, row[k]), min(e, row[k])
        for k in range(row.size):
            total += row[k]
            squares += row[k] * row[k]
        out[r, 0], out[r, 1] = max(max(a, b), max(c, d)), min(min(e, f), min(g, h))
        out[r, 2], out[r, 3] = total, squares


# All measures of consecutive cells.

CHUNK = 1024
"""Cells that are measured together: what is known of them stays in the cache."""


@vectorised
def skewnesses(tangents: Array) -> None:
    """From the tangents of angles, none negative, to the angles as shares of a right one, to rounding.

    The ranges and the quotient of polynomials are those of S. L. Moshier's Cephes library.
    """
    for k in range(tangents.size):
        tangent = tangents[k]
        is_large, is_small = tangent > 2.414213562373095, tangent <= 0.66
        above = -1.0 if is_large else (tangent if is_small else tangent - 1.0)
        below = tangent if is_large else (1.0 if is_small else tangent + 1.0)
        x = above / below
        begin = 0.5 * np.pi if is_large else (0.0 if is_small else 0.25 * np.pi)
        z = x * x
        p = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1
        p = ((p * z - 7.500855792314704667340e1) * z - 1.228866684490136173410e2) * z - 6.485021904942025371773e1
        q = (z + 2.485846490142306297962e1) * z + 1.650270098316988542046e2
        q = ((q * z + 4.328810604912902668951e2) * z + 4.853903996359136964868e2) * z + 1.945506571482613964425e2
        tangents[k] = (begin + (x + x * z * p / q)) / (0.5 * np.pi)


@compiled
def measure_shapes(corners: Array, area: Array, valid: BoolArray, metric: Array, rows: Array) -> None:
    """Fill the first six of ``rows``, in the order of :data:`ROWS`, the first not yet scaled."""
    shares_and_alignments(corners, area, valid, metric, rows[:2])
    shapes(corners, valid, rows[2:6])
    skewnesses(rows[4])


@compiled
def survey_cells(
    nodes: Pair,
    tables: tuple[IntArray, IntArray],
    known: tuple[Array, BoolArray],
    place: int,
    mean: Array,
    parts: Array,
    kept: Array,
    to: int,
) -> float:
    """The sum of the shares of valid cells; ``parts`` is set to the :func:`fill_parts` of all measures.

    The cells are those from ``place`` on, one for each ``mean`` metric, shape ``(3, n)``. ``tables`` and what is
    ``known``, area and validity, are those of all held cells. As many measures as ``kept`` has rows go there, from
    ``to`` on.
    """
    (x, y), (cells, neighbours), (area, valid) = nodes, tables, known
    total = 0.0
    for begin in range(0, mean.shape[1], CHUNK):
        first, size = place + begin, min(CHUNK, mean.shape[1] - begin)
        corners, metric, rows, found = np.empty((8, size)), np.empty((3, size)), np.empty((7, size)), np.empty((7, 4))
        if len(cells):
            gather_corners(x[0], y[0], cells[first : first + size], corners)
        else:
            gather_row_of_cells(x, y, first, corners)
        for r in range(3):
            for k in range(size):
                metric[r, k] = mean[r, begin + k]
        measure_shapes(corners, area[first : first + size], valid[first : first + size], metric, rows)
        if len(neighbours):
            size_ratios_of(neighbours, first, valid, area, rows[6])
        else:
            size_ratios(x.shape[1] - 1, first, valid, area, rows[6])
        fill_parts(rows, found)
        if np.isfinite(found[0, 2]):
            total += found[0, 2]
        else:
            for k in range(size):
                total += rows[0, k] if valid[first + k] else 0.0
        if begin:
            join_parts(parts, found)
        else:
            parts[:] = found
        for r in range(len(kept)):
            for k in range(size):
                kept[r, to + begin + k] = rows[r, k]
    return total


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
        strips, own, columns = cells.rows.strips, cells.own, cells.shape[1]
        is_kept = keep or cells.count <= MAX_KEPT_CELLS
        kept = np.empty((len(ROWS) if is_kept else 1, own.stop - own.start))
        parts, shares = np.empty((len(strips), len(ROWS), 4)), np.zeros(len(strips))
        known = cells.area, cells.valid  # before the threads need them
        metrics: _Inside | _AtNodes
        if rule is CellPoints.corners():
            metrics = _AtNodes.of(cells, monitor)
        else:
            of_derivatives = monitor if tally is not None and isinstance(monitor, OfDerivatives) else None
            metrics = _Inside(cells, monitor, rule, tally if cells.all_valid else None, of_derivatives)
        nodes, tables = cells.grid_nodes, cells.tables

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for number in range(thread, len(strips), threads):
                    first, last = strips[number]
                    span = slice(first * columns, last * columns)
                    mean, place = metrics.means(first, last), cells.places(span).start
                    to = span.start - own.start
                    shares[number] = survey_cells(nodes, tables, known, place, mean, parts[number], kept, to)

        share_blocks(work, own.stop - own.start, threads)
        found = cells.rows.joined(np.column_stack([shares, parts.reshape(len(strips), -1)]))
        with np.errstate(all="ignore"):
            factor = np.float64(cells.count) / found[:, 0].sum()
            kept[0] *= factor
        statistics = Statistics.of(found[:, 1:].reshape(-1, len(ROWS), 4), cells.count)
        statistics[0] = statistics[0].times(float(factor))
        return cls(statistics=tuple(statistics), q_eq=kept[0], kept=kept if is_kept else None, nodal=metrics.nodal)


# The mean metric of every cell, by one of two rules: points inside the cells, or their corners. Threads may ask for
# those of different rows.


@dataclass(frozen=True, eq=False)
class _Inside:
    """By points inside every cell, at which ``tally`` counts the errors of interpolation."""

    cells: MeshCells
    monitor: Monitor
    rule: CellPoints
    tally: ErrorTally | None
    of_derivatives: OfDerivatives | None
    """The monitor, where u is evaluated once for the metric and for ``tally``."""
    nodal: Array | None = None

    def means(self, first: int, last: int) -> Array:
        """The mean metrics of the cells of the rows ``first`` to ``last - 1``, shape ``(3, cells)``."""
        cells, columns = self.cells, self.cells.shape[1]
        mean = np.full((3, (last - first) * columns), np.nan)  # u need not be defined where a folded cell reaches
        of_all = self.tally is not None or cells.all_valid
        for block in pieces(first * columns, last * columns, cells_of_block(self.rule)):
            corners, here, to = cells.corners(block), cells.places(block), block.start - first * columns
            if of_all:
                mean[:, to : to + corners.shape[1]] = self._of_valid(corners, cells.area[here], block)
            else:
                chosen = np.flatnonzero(cells.valid[here])
                some = np.ascontiguousarray(corners[:, chosen])
                mean[:, to + chosen] = self._of_valid(some, cells.area[here][chosen], block)
        return mean

    def _of_valid(self, corners: Array, area: Array, block: slice) -> Array:
        rule, monitor, tally = self.rule, self.of_derivatives, self.tally
        x, y = np.empty((2, rule.s.size, area.size))
        locate(corners, rule.s, rule.t, x, y)
        mean = np.empty((3, area.size))
        if tally is not None and monitor is not None:
            derivatives = tally.u.evaluate(x, y, monitor.order)
            entries = monitor.metric_of(*derivatives)
        else:
            entries = self.monitor.metric(x, y)
            derivatives = () if tally is None else tally.u.evaluate(x, y, 1)
        if tally is not None:
            start = self.cells.own.start
            tally.add(slice(block.start - start, block.stop - start), corners, derivatives)
        mean_metrics(corners, area, rule, contiguous(entries), mean)
        return mean


@dataclass(frozen=True, eq=False)
class _AtNodes:
    """By the corners of every cell, where neighbours share the metric; on blocks it is known ``everywhere``.

    ``nodal`` is u at the held nodes, where it was needed.
    """

    cells: MeshCells
    monitor: Monitor
    nodal: Array | None
    of_derivatives: OfDerivatives | None
    everywhere: list[tuple[Array, Array, Array]]

    @classmethod
    def of(cls, cells: MeshCells, monitor: Monitor) -> _AtNodes:
        """Nothing yet; on blocks the metric at all nodes."""
        of_derivatives = monitor if isinstance(monitor, OfDerivatives) and monitor.u is not None else None
        nodal = None if of_derivatives is None else np.empty(cells.nodes[0].shape)
        if nodal is not None and not cells.rows.are_all:
            nodal.fill(np.nan)
        found = cls(cells, monitor, nodal, of_derivatives, [])
        if not isinstance(cells, BilinearCells):
            found.everywhere.append(found._at(*cells.nodes, found.nodal))
        return found

    def means(self, first: int, last: int) -> Array:
        """As :meth:`_Inside.means`."""
        cells, columns = self.cells, self.cells.shape[1]
        mean = np.empty((3, (last - first) * columns))
        if isinstance(cells, BilinearCells):
            begin, (x, y) = cells.rows.begin, cells.window.nodes(first, last)
            nodal = None if self.nodal is None else self.nodal[first - begin : last + 1 - begin]
            nodal_means(x, y, self._at(x, y, nodal), mean)
            return mean
        numbers = np.arange(first * columns, last * columns)
        m11, m12, m22 = (cells.corner_values(entry, numbers) for entry in self.everywhere[0])
        corners = cells.corners(numbers)
        mean_metrics(corners, cells.area[numbers], CellPoints.corners(), (m11, m12, m22), mean)
        return mean

    def _at(self, x: Array, y: Array, nodal: Array | None) -> tuple[Array, Array, Array]:
        """The metric at these nodes; u there goes to ``nodal``."""
        monitor, u = self.of_derivatives, self.monitor.u
        with np.errstate(all="ignore"):
            if nodal is None or u is None or monitor is None:
                return contiguous(self.monitor.metric(x, y))
            derivatives = u.evaluate(x, y, monitor.order)
            nodal[...] = derivatives[0]
            return contiguous(monitor.metric_of(*derivatives))


def contiguous(entries: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    """The entries of a metric, as compiled loops read them."""
    m11, m12, m22 = (np.ascontiguousarray(entry, dtype=float) for entry in entries)
    return m11, m12, m22
