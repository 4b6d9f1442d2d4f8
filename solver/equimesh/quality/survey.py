"""One pass over all cells of a mesh: what it measures of every cell, and what is left of that in statistics.

The own cells are looked at. The statistics of all strips give those of the mesh.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from equimesh.monitors.monitor import Monitor, OfDerivatives
from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array
from equimesh.quality.cell_maps import locate, shapes, shares_and_alignments
from equimesh.quality.cells import CellPoints, MeshCells
from equimesh.quality.tally import ErrorTally, mean_metrics, share_blocks

# Extremes, mean and root mean square of numbers that come in blocks.


class Statistics(NamedTuple):
    """The largest and the smallest of some numbers, their mean and the root of the mean of their squares."""

    max: float
    min: float
    mean: float
    rms: float

    @classmethod
    def of(cls, parts: Array, count: int) -> Statistics:
        """Those of ``count`` numbers, from the :func:`parts` of their blocks, of shape ``(blocks, 4)``."""
        total, squares = float(parts[:, 2].sum()), float(parts[:, 3].sum())
        return cls(float(parts[:, 0].max()), float(parts[:, 1].min()), total / count, math.sqrt(squares / count))

    def times(self, factor: float) -> Statistics:
        """Those of the numbers times a positive ``factor``."""
        return Statistics(*(factor * value for value in self))


def fill_parts(rows: Array, out: Array) -> None:
    """Fill ``out``, of shape ``(rows, 4)``, with the largest and smallest, the sum and the sum of squares of each row.

    Where a number is not finite they are what numpy says.
    """
    fast_parts(rows, out)
    for row, part in zip(rows, out, strict=True):
        if not math.isfinite(part[3]):
            part[:] = row.max(), row.min(), row.sum(), np.square(row).sum()


@vectorised
def fast_parts(rows: Array, out: Array) -> None:
    """As :func:`fill_parts` where all numbers are finite; where one is not, the last number of its row is neither."""
    for r in range(rows.shape[0]):
        row = rows[r]
        high, low, total, squares = row[0], row[0], 0.0, 0.0
        for k in range(row.size):
            high, low = max(high, row[k]), min(low, row[k])
            total += row[k]
            squares += row[k] * row[k]
        out[r, 0], out[r, 1], out[r, 2], out[r, 3] = high, low, total, squares


ROWS = ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures that have one value per cell, in the order of the rows of an array of them."""
MAX_KEPT_CELLS = 16_384
"""On at most this many cells all values are kept, since they exist anyway."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """The statistics of all measures, in the order of :data:`ROWS`, and ``q_eq`` of every own cell.

    ``kept`` are all values of the own cells, of shape ``(7, cells)``, or ``None`` where they are not kept.
    """

    statistics: tuple[Statistics, ...]
    q_eq: Array
    kept: Array | None

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

        ``tally`` counts the errors of interpolation at the same points. ``keep`` keeps all values in any case.
        """
        blocks, own = list(cells.blocks(rule)), cells.own
        kept = np.empty((len(ROWS), own.stop - own.start)) if keep or cells.count <= MAX_KEPT_CELLS else None
        q_eq = np.empty(own.stop - own.start) if kept is None else kept[0]
        parts = np.empty((len(blocks), len(ROWS), 4))
        shares = np.empty(len(blocks))
        known = cells.all_valid  # before the threads need it

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for number in range(thread, len(blocks), threads):
                    block = blocks[number]
                    rows = np.empty((len(ROWS), block.stop - block.start))
                    shares[number] = _measure(cells, monitor, rule, block, rows, tally if known else None)
                    fill_parts(rows, parts[number])
                    here = _places(cells, block)
                    if kept is None:
                        q_eq[here] = rows[0]
                    else:
                        kept[:, here] = rows

        share_blocks(work, own.stop - own.start, threads)
        with np.errstate(all="ignore"):
            found, total = _of_strips(cells, blocks, parts, shares)
            factor = np.float64(cells.count) / total
            q_eq *= factor
        statistics = [Statistics.of(found[:, row], cells.count) for row in range(len(ROWS))]
        return cls(statistics=(statistics[0].times(float(factor)), *statistics[1:]), q_eq=q_eq, kept=kept)


def _of_strips(cells: MeshCells, blocks: list[slice], parts: Array, shares: Array) -> tuple[Array, float]:
    """The statistics of all strips, of shape ``(strips, 7, 4)``, and the sum of all shares."""
    starts = {first * cells.shape[1] for first, _ in cells.rows.strips}
    at = [k for k, block in enumerate(blocks) if block.start in starts]
    strips = np.empty((len(at), len(ROWS), 4))
    for column, reduced in enumerate((np.maximum, np.minimum, np.add, np.add)):
        strips[:, :, column] = reduced.reduceat(parts[:, :, column], at, axis=0)
    sums = np.add.reduceat(shares, at)
    found = cells.rows.joined(np.column_stack([sums, strips.reshape(len(at), -1)]))
    return found[:, 1:].reshape(-1, len(ROWS), 4), float(found[:, 0].sum())


def _measure(
    cells: MeshCells, monitor: Monitor, rule: CellPoints, block: slice, rows: Array, tally: ErrorTally | None
) -> float:
    """Fill ``rows`` of the measures of some cells, the first one not yet scaled; returns its sum over valid cells."""
    here = cells.places(block)
    corners, area, valid = cells.corners(block), cells.area[here], cells.valid[here]
    if cells.all_valid:
        metric = _mean_metrics(corners, area, monitor, rule, _places(cells, block), tally)
    else:  # u need not be defined where a folded cell reaches
        metric = np.full((3, area.size), np.nan)
        chosen = np.flatnonzero(valid)
        some = np.ascontiguousarray(corners[:, chosen])
        metric[:, chosen] = _mean_metrics(some, area[chosen], monitor, rule, _places(cells, block), None)
    shares_and_alignments(corners, area, valid, metric, rows[:2])
    shapes(corners, valid, rows[2:6])
    np.arctan(rows[4], out=rows[4])
    rows[4] /= 0.5 * np.pi
    cells.size_ratios(block, rows[6])
    return float(rows[0].sum() if cells.all_valid else rows[0].sum(where=valid))


def _places(cells: MeshCells, block: slice) -> slice:
    return slice(block.start - cells.own.start, block.stop - cells.own.start)


def _mean_metrics(
    corners: Array, area: Array, monitor: Monitor, rule: CellPoints, own: slice, tally: ErrorTally | None
) -> Array:
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
    m11, m12, m22 = (np.ascontiguousarray(entry) for entry in entries)
    mean_metrics(corners, area, rule, (m11, m12, m22), mean)
    return mean
