"""The density of a monitor on the reference square, as tables for grids of all sizes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from equimesh.domains.domain import Domain
from equimesh.gradient_map.kernels import average
from equimesh.meshes.grid import Grid
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array

MIN_TABLE_CELLS = 128
"""Cells a side of the table, at least: a density that is thinner than the cells of a coarse grid is seen."""
MAX_TABLE_CELLS = 1024
"""Cells a side of the table, at most."""
MIN_DENSITY_SHARE = 1e-12
"""Smaller densities count as this share of the largest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Density:
    """``sqrt(det M)`` times the Jacobian of the domain's map, at the nodes of a uniform grid of the reference square.

    ``table`` has shape ``(m_xi + 1, m_eta + 1)``, both m powers of 2, and a largest value of 1. ``extents`` are the
    mean lengths of the images of the lines along xi and along eta.
    """

    table: Array
    extents: tuple[float, float]

    @classmethod
    def of(cls, monitor: Monitor, domain: Domain, grid: Grid) -> Density:
        """The density of a bound monitor, on a table fine enough for ``grid``."""
        axes = [np.linspace(0.0, 1.0, _table_cells(n - 1) + 1) for n in grid.shape]
        s, t = np.meshgrid(*axes, indexing="ij")
        m11, m12, m22 = monitor.metric(*domain.map(s, t))
        x_s, x_t, y_s, y_t = domain.jacobian(s, t)
        density = np.sqrt(m11 * m22 - m12**2) * (x_s * y_t - x_t * y_s)
        density /= density.max()
        extents = float(np.hypot(x_s, y_s).mean()), float(np.hypot(x_t, y_t).mean())
        return cls(table=np.maximum(density, MIN_DENSITY_SHARE), extents=extents)

    @property
    def is_finite(self) -> bool:
        """Whether the density is finite everywhere."""
        return bool(np.isfinite(self.table).all())

    def on(self, grid: Grid) -> Array:
        """The table for the cells of ``grid``, averaged so that no detail is much finer than its cells."""
        table = self.table
        for axis, n in enumerate(grid.shape):
            while table.shape[axis] - 1 >= 2 * (n - 1):
                table = _halved(table, axis)
        smooth = np.array(table, order="C")
        average(smooth, np.empty_like(smooth), True)
        return smooth


def _table_cells(cells: int) -> int:
    """The smallest power of 2 that is enough, within the limits."""
    return int(min(max(1 << (cells - 1).bit_length(), MIN_TABLE_CELLS), MAX_TABLE_CELLS))


def _halved(table: Array, axis: int) -> Array:
    """Every second node along an axis, with the average of its neighbourhood."""
    rows = np.moveaxis(table, axis, 0)
    half = 0.5 * rows[::2]
    half[1:-1] += 0.25 * (rows[1:-2:2] + rows[3::2])
    half[0] += 0.5 * rows[1]
    half[-1] += 0.5 * rows[-2]
    result: Array = np.moveaxis(half, 0, axis)
    return result
