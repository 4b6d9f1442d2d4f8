"""The grids of a least-error solve, from coarse to fine, with the work on each."""

from __future__ import annotations

import math
from dataclasses import dataclass

from equimesh.meshes.grid import Grid

COARSEST_CELLS = 8
"""Cells a side of the coarsest grid, or up to a half more."""
STEPS = ((17 * 17, 45), (33 * 33, 40), (65 * 65, 18), (129 * 129, 5), (257 * 257, 2))
"""Steps of descent, at most, on grids of at most this many points."""
STEPS_BEYOND = 1
"""Steps on finer grids, at most: the coarser ones have done the work."""
GAUSS_POINTS = ((9 * 9, 4), (17 * 17, 3))
"""Gauss points a direction and cell on grids of at most this many points."""
GAUSS_POINTS_BEYOND = 2
"""On finer grids."""


@dataclass(frozen=True, kw_only=True)
class Level:
    """One of the nested grids."""

    number: int
    """0 for the coarsest grid."""
    count: int
    """How many grids there are."""
    grid: Grid

    @property
    def points(self) -> int:
        """Number of nodes."""
        return self.grid.points

    @property
    def is_finest(self) -> bool:
        """Whether the grid is the requested one."""
        return self.number + 1 == self.count

    @property
    def steps(self) -> int:
        """Steps of descent."""
        return next((steps for points, steps in STEPS if self.grid.points <= points), STEPS_BEYOND)

    @property
    def gauss_points(self) -> int:
        """Gauss points a direction and cell."""
        return next((count for points, count in GAUSS_POINTS if self.grid.points <= points), GAUSS_POINTS_BEYOND)


def nested_levels(grid: Grid) -> list[Level]:
    """The levels up to ``grid``. The coarsest has about as many points in both directions, whatever the grid has."""
    halvings = [max(0, round(math.log2((n - 1) / COARSEST_CELLS))) for n in grid.shape]
    count = max(halvings) + 1
    levels = []
    for number in range(count):
        cells = [
            max(3, round((n - 1) / 2 ** max(halved - number, 0)))
            for n, halved in zip(grid.shape, halvings, strict=True)
        ]
        levels.append(Level(number=number, count=count, grid=Grid(n_xi=cells[0] + 1, n_eta=cells[1] + 1)))
    return levels
