"""One pass over all cells of a mesh: what it measures of every cell, and what is left of that in statistics."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.monitors.monitor import Monitor, OfDerivatives
from equimesh.numerics.types import Array
from equimesh.quality.cell_errors import mean_metrics
from equimesh.quality.cell_shapes import shapes, shares_and_alignments, size_ratios
from equimesh.quality.cells import BilinearCells, CellPoints, locate
from equimesh.quality.statistics import Statistics, fill_parts
from equimesh.quality.tally import ErrorTally, share_blocks

ROWS = ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "skewness", "aspect_ratio", "size_ratio")
"""The measures that have one value per cell, in the order of the rows of an array of them."""
MAX_KEPT_CELLS = 16_384
"""On at most this many cells all values are kept, since they exist anyway."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """The statistics of all measures, in the order of :data:`ROWS`, and ``q_eq`` of every cell.

    ``kept`` are all values, of shape ``(7, cells)``, or ``None`` where they are not kept.
    """

    statistics: tuple[Statistics, ...]
    q_eq: Array
    kept: Array | None

    @classmethod
    def of(
        cls,
        cells: BilinearCells,
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
        blocks = [block for block in cells.blocks(rule) if isinstance(block, slice)]
        kept = np.empty((len(ROWS), cells.count)) if keep or cells.count <= MAX_KEPT_CELLS else None
        q_eq = np.empty(cells.count) if kept is None else kept[0]
        parts = np.empty((len(blocks), len(ROWS), 4))
        shares = np.empty(len(blocks))

        def work(thread: int, threads: int) -> None:
            with np.errstate(all="ignore"):
                for number in range(thread, len(blocks), threads):
                    block = blocks[number]
                    rows = np.empty((len(ROWS), block.stop - block.start))
                    shares[number] = _measure(cells, monitor, rule, block, rows, tally)
                    fill_parts(rows, parts[number])
                    if kept is None:
                        q_eq[block] = rows[0]
                    else:
                        kept[:, block] = rows

        share_blocks(work, cells.count, threads)
        with np.errstate(all="ignore"):
            factor = cells.count / shares.sum()
            q_eq *= factor
        found = [Statistics.of(parts[:, row], cells.count) for row in range(len(ROWS))]
        return cls(statistics=(found[0].times(float(factor)), *found[1:]), q_eq=q_eq, kept=kept)


def _measure(
    cells: BilinearCells, monitor: Monitor, rule: CellPoints, block: slice, rows: Array, tally: ErrorTally | None
) -> float:
    """Fill ``rows`` of the measures of some cells, the first one not yet scaled; returns its sum over valid cells."""
    corners, area, valid = cells.corners(block), cells.area[block], cells.valid[block]
    if cells.all_valid:
        metric = _mean_metrics(corners, area, monitor, rule, block, tally)
    else:  # u need not be defined where a folded cell reaches
        metric = np.full((3, area.size), np.nan)
        chosen = np.flatnonzero(valid)
        some = np.ascontiguousarray(corners[:, chosen])
        metric[:, chosen] = _mean_metrics(some, area[chosen], monitor, rule, block, None)
    shares_and_alignments(corners, area, valid, metric, rows[:2])
    shapes(corners, valid, rows[2:6])
    np.arctan(rows[4], out=rows[4])
    rows[4] /= 0.5 * np.pi
    size_ratios(cells.shape[1], block.start, cells.valid, cells.area, rows[6])
    return float(rows[0].sum() if cells.all_valid else rows[0].sum(where=valid))


def _mean_metrics(
    corners: Array, area: Array, monitor: Monitor, rule: CellPoints, block: slice, tally: ErrorTally | None
) -> Array:
    x, y = np.empty((2, rule.s.size, area.size))
    locate(corners, rule.s, rule.t, x, y)
    mean = np.empty((3, area.size))
    if tally is not None and isinstance(monitor, OfDerivatives):
        derivatives = tally.u.evaluate(x, y, monitor.order)
        entries = monitor.metric_of(*derivatives)
        tally.add(block, corners, derivatives)
    else:
        entries = monitor.metric(x, y)
        if tally is not None:
            tally.add(block, corners, tally.u.evaluate(x, y, 1))
    m11, m12, m22 = (np.ascontiguousarray(entry) for entry in entries)
    mean_metrics(corners, area, rule, (m11, m12, m22), mean)
    return mean
