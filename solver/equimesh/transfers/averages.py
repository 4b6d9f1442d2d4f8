"""The conservative transfer of averages over cells."""

import numpy as np

from equimesh.numerics.types import Array
from equimesh.transfers.integrals import total
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.quad_cells import QuadCells
from equimesh.transfers.quad_slopes import slopes_of_quads
from equimesh.transfers.repair import share_out
from equimesh.transfers.slopes import slopes_of_averages


def transfer_averages(overlaps: Overlaps, averages: Array, bounds: tuple[float, float] | None = None) -> Array:
    """Averages over the old cells as averages over the new ones, flat.

    In each old cell the function is linear with limited slopes; the integrals over the common parts of old and new
    cells are exact. Every new average therefore lies between the bounds of the old cells that it meets, and between
    ``bounds``, or the least and the largest old average. Where a side is curved, the two meshes cover slightly
    different areas, and the integral over all cells is brought to the old one within these bounds:
    see :mod:`~equimesh.transfers.transfer`.
    """
    least, most = float(averages.min()), float(averages.max())
    if bounds is not None:  # values may be beyond them by rounding
        least, most = min(least, bounds[0]), max(most, bounds[1])
    old = overlaps.old
    if isinstance(old, QuadCells):
        slopes, (lowest, highest) = slopes_of_quads(old, averages, least, most)
    else:
        slopes, (lowest, highest) = slopes_of_averages(old, averages, least, most)
    low, high = overlaps.bounds(lowest, highest)
    moved = np.clip(overlaps.integrals(averages, slopes) / overlaps.new.area, low, high)
    aim = total(old.area, averages)
    beyond = overlaps.beyond != 0.0
    if beyond.any():  # at first only the cells at the curved sides change
        share_out(moved, overlaps.new.area, np.where(beyond, low, moved), np.where(beyond, high, moved), aim)
    share_out(moved, overlaps.new.area, low, high, aim)
    return moved
