"""What a function adds to the shapes of the cells of a mesh: equidistribution and alignment, and the errors of u.

The own cells are looked at. The statistics of all strips give those of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from equimesh.meshes.mesh import MeshRows
from equimesh.monitors.monitor import Monitor, OfDerivatives
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array, BoolArray, IntArray, Pair
from equimesh.quality.cell_maps import locate, shares_and_alignments
from equimesh.quality.cells import BilinearCells, CellPoints, MeshCells, cells_of_block, pieces
from equimesh.quality.shapes import CHUNK, MAX_KEPT_CELLS, Statistics, fill_parts, gather_any, join_parts
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


# Shares and alignments of rows of valid cells, between two rows of nodes: ``x0``, ``y0`` of the first, ``x1``, ``y1``
# of the second.


@vectorised
def corner_shares(x0: Array, x1: Array, y0: Array, y1: Array, out: Array) -> None:
    """The share of each corner in the area of its cell, counter-clockwise, by the determinants there."""
    a, b, c, d = out[0], out[1], out[2], out[3]
    for j in range(a.size):
        ex0, ey0, ex1, ey1 = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x0[j + 1], y1[j + 1] - y0[j + 1]
        fx0, fy0, fx1, fy1 = x0[j + 1] - x0[j], y0[j + 1] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
        p, q = ex0 * fy0 - ey0 * fx0, ex0 * fy1 - ey0 * fx1
        r, s = ex1 * fy1 - ey1 * fx1, ex1 * fy0 - ey1 * fx0
        per = 1.0 / (p + q + r + s)
        a[j], b[j], c[j], d[j] = p * per, q * per, r * per, s * per


@compiled
def mean_of_corners(shares: Array, low: Array, high: Array, out: Array) -> None:
    """The mean of a function over each cell of a row, from its values ``low`` and ``high`` at two rows of nodes."""
    a, b, c, d = shares[0], shares[1], shares[2], shares[3]
    for j in range(out.size):
        out[j] = a[j] * low[j] + b[j] * high[j] + c[j] * high[j + 1] + d[j] * low[j + 1]


@compiled
def align_row(x0: Array, x1: Array, y0: Array, y1: Array, metric: Array, out: Array) -> None:
    """As :func:`~equimesh.quality.cell_maps.shares_and_alignments` of a row of valid cells."""
    m11, m12, m22, share, alignment = metric[0], metric[1], metric[2], out[0], out[1]
    for j in range(share.size):
        ax, ay, bx, by = x1[j] - x0[j], y1[j] - y0[j], x1[j + 1] - x1[j], y1[j + 1] - y1[j]
        cx, cy, dx, dy = x0[j + 1] - x1[j + 1], y0[j + 1] - y1[j + 1], x0[j] - x0[j + 1], y0[j] - y0[j + 1]
        aa = m11[j] * ax * ax + 2.0 * m12[j] * ax * ay + m22[j] * ay * ay
        bb = m11[j] * bx * bx + 2.0 * m12[j] * bx * by + m22[j] * by * by
        cc = m11[j] * cx * cx + 2.0 * m12[j] * cx * cy + m22[j] * cy * cy
        dd = m11[j] * dx * dx + 2.0 * m12[j] * dx * dy + m22[j] * dy * dy
        da, ab, bc, cd = dx * ay - dy * ax, ax * by - ay * bx, bx * cy - by * cx, cx * dy - cy * dx
        p, q, r, s = (dd + aa) / da, (aa + bb) / ab, (bb + cc) / bc, (cc + dd) / cd
        volume = np.sqrt(m11[j] * m22[j] - m12[j] * m12[j])
        share[j] = 0.25 * volume * (da + ab + bc + cd)
        alignment[j] = max(max(p, q), max(r, s)) / (2.0 * volume)


@compiled
def align_rows(
    nodes: Pair, first: int, last: int, metric: tuple[Array, Array, Array], parts: Array, kept: Array, to: int
) -> None:
    """Shares and alignments of the rows of valid cells ``first`` to ``last - 1``: ``parts`` as of all measures.

    ``metric`` is that at the nodes of these rows, or the mean over their cells. As many measures as ``kept`` has rows
    go there, from ``to`` on.
    """
    (x, y), columns = nodes, nodes[0].shape[1] - 1
    shares, mean, rows, found = np.empty((4, columns)), np.empty((3, columns)), np.empty((2, columns)), np.empty((2, 4))
    at_nodes = metric[0].shape[0] > last - first
    for r in range(2):
        parts[r, 0], parts[r, 1], parts[r, 2], parts[r, 3] = -np.inf, np.inf, 0.0, 0.0
    for i in range(first, last):
        x0, x1, y0, y1, k = x[i], x[i + 1], y[i], y[i + 1], i - first
        if at_nodes:
            corner_shares(x0, x1, y0, y1, shares)
        for r in range(3):
            entry = metric[0] if r == 0 else (metric[1] if r == 1 else metric[2])
            if at_nodes:
                mean_of_corners(shares, entry[k], entry[k + 1], mean[r])
            else:
                for j in range(columns):
                    mean[r, j] = entry[k, j]
        align_row(x0, x1, y0, y1, mean, rows)
        fill_parts(rows, found)
        join_parts(parts, found)
        for r in range(len(kept)):
            for j in range(columns):
                kept[r, to + k * columns + j] = rows[r, j]


@compiled
def align_cells(
    nodes: Pair,
    cells: IntArray,
    known: tuple[Array, BoolArray],
    place: int,
    mean: Array,
    parts: Array,
    kept: Array,
    to: int,
) -> float:
    """As :func:`align_rows` for any cells from ``place`` on, one for each ``mean`` metric, shape ``(3, n)``.

    Returns the sum of the shares of valid cells. ``cells`` and what is ``known`` as of
    :func:`~equimesh.quality.shapes.survey_shapes`.
    """
    (area, valid), total = known, 0.0
    for r in range(2):
        parts[r, 0], parts[r, 1], parts[r, 2], parts[r, 3] = -np.inf, np.inf, 0.0, 0.0
    for begin in range(0, mean.shape[1], CHUNK):
        first, size = place + begin, min(CHUNK, mean.shape[1] - begin)
        corners, metric, rows, found = np.empty((8, size)), np.empty((3, size)), np.empty((2, size)), np.empty((2, 4))
        gather_any(nodes, cells, first, corners)
        for r in range(3):
            for k in range(size):
                metric[r, k] = mean[r, begin + k]
        shares_and_alignments(corners, area[first : first + size], valid[first : first + size], metric, rows)
        fill_parts(rows, found)
        join_parts(parts, found)
        for k in range(size):
            total += rows[0, k] if valid[first + k] else 0.0
        for r in range(len(kept)):
            for k in range(size):
                kept[r, to + begin + k] = rows[r, k]
    return total


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """What a function adds to the shapes of a mesh: statistics of ``q_eq`` and ``q_ali``, and ``q_eq`` of own cells.

    ``kept`` has both of the own cells, shape ``(2, cells)``, or ``None`` where they are not kept. ``nodal`` is u at the
    held nodes around own cells, where the metric was evaluated there and depends on u alone.
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
        kept = np.empty((2 if is_kept else 1, own.stop - own.start))
        parts, shares = np.empty((len(strips), 2, 4)), np.zeros(len(strips))
        in_rows = isinstance(cells, BilinearCells) and cells.all_valid
        metrics: _Inside | _AtNodes
        if rule is CellPoints.corners():
            metrics = _AtNodes.of(cells, monitor)
        else:
            of_derivatives = None if tally is None else _of_derivatives(monitor)
            _ = cells.area  # before the threads need it
            metrics = _Inside(cells, monitor, rule, tally if cells.all_valid else None, of_derivatives)
        nodes = cells.grid_nodes
        others = None if in_rows else (cells.tables[0], (cells.area, cells.valid))

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for number in range(thread, len(strips), threads):
                    first, last = strips[number]
                    span = slice(first * columns, last * columns)
                    place, to = cells.places(span).start, span.start - own.start
                    if others is None:
                        begin = place // columns
                        align_rows(
                            nodes, begin, begin + last - first, metrics.rows(first, last), parts[number], kept, to
                        )
                        shares[number] = parts[number, 0, 2]
                    else:
                        mean = metrics.means(first, last)
                        shares[number] = align_cells(nodes, *others, place, mean, parts[number], kept, to)

        share_blocks(work, own.stop - own.start, threads)
        found = cells.rows.joined(np.column_stack([shares, parts.reshape(len(strips), -1)]))
        with np.errstate(all="ignore"):
            factor = np.float64(cells.count) / found[:, 0].sum()
            kept[0] *= factor
        statistics = Statistics.of(found[:, 1:].reshape(-1, 2, 4), cells.count)
        statistics[0] = statistics[0].times(float(factor))
        return cls(statistics=tuple(statistics), q_eq=kept[0], kept=kept if is_kept else None, nodal=metrics.nodal)


def _of_derivatives(monitor: Monitor) -> OfDerivatives | None:
    """The monitor if it is one of derivatives; a look at the whole protocol takes as long as to measure 100 cells."""
    return cast(OfDerivatives, monitor) if hasattr(monitor, "metric_of") else None


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

    def rows(self, first: int, last: int) -> tuple[Array, Array, Array]:
        """The same in rows."""
        m11, m12, m22 = self.means(first, last).reshape(3, last - first, -1)
        return m11, m12, m22

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
    """By the corners of every cell, which neighbours share; known ``everywhere`` unless it is a valid grid.

    ``nodal`` is u at the held nodes, where it was needed.
    """

    cells: MeshCells
    monitor: Monitor
    nodal: Array | None
    of_derivatives: OfDerivatives | None
    everywhere: list[tuple[Array, Array, Array]]

    @classmethod
    def of(cls, cells: MeshCells, monitor: Monitor) -> _AtNodes:
        """Nothing yet of a valid grid, else the metric at all nodes."""
        of_derivatives = None if monitor.u is None else _of_derivatives(monitor)
        nodal = None if of_derivatives is None else np.empty(cells.nodes[0].shape)
        if nodal is not None and not cells.rows.are_all:
            nodal.fill(np.nan)
        found = cls(cells, monitor, nodal, of_derivatives, [])
        if not isinstance(cells, BilinearCells) or not cells.all_valid:
            found.everywhere.append(found._at(*cells.nodes, found.nodal))
        return found

    def rows(self, first: int, last: int) -> tuple[Array, Array, Array]:
        """The metric at the nodes of these rows of the cells of a grid."""
        begin, (x, y) = self.cells.rows.begin, MeshRows.of(self.cells.mesh).nodes(first, last)
        return self._at(x, y, None if self.nodal is None else self.nodal[first - begin : last + 1 - begin])

    def means(self, first: int, last: int) -> Array:
        """As :meth:`_Inside.means`."""
        cells, columns = self.cells, self.cells.shape[1]
        mean = np.empty((3, (last - first) * columns))
        numbers = np.arange(first * columns, last * columns)
        m11, m12, m22 = (cells.corner_values(entry, numbers) for entry in self.everywhere[0])
        area = cells.area[cells.places(slice(first * columns, last * columns))]
        mean_metrics(cells.corners(numbers), area, CellPoints.corners(), (m11, m12, m22), mean)
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
