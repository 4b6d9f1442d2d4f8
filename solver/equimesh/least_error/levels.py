"""The nested meshes of a least-error solve, from coarse to fine, with the work on each."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from equimesh.meshes.grid import Grid

COARSEST_CELLS = 8
"""Cells a side of the coarsest grid, or up to a half more."""
STEPS = ((17 * 17, 45), (33 * 33, 40), (65 * 65, 18), (129 * 129, 5), (257 * 257, 2))
"""Steps of descent, at most, on meshes of at most this many points."""
STEPS_BEYOND = 1
"""Steps on finer meshes, at most: the coarser ones have done the work."""
GAUSS_POINTS = ((9 * 9, 4), (17 * 17, 3))
"""Gauss points a direction and cell on meshes of at most this many points."""
GAUSS_POINTS_BEYOND = 2
"""On finer meshes."""
MAX_COMPARED_POINTS = 17 * 17
"""Points of the mesh, at most, on which the starts are compared."""
MAX_COARSE_POINTS = 40 * 40
"""Points, at most, of the mesh on which weights and monitors are compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Level(ABC):
    """One of the nested meshes."""

    number: int
    """0 for the coarsest mesh."""
    count: int
    """How many meshes there are."""

    @property
    @abstractmethod
    def points(self) -> int:
        """Number of nodes."""

    @property
    def is_finest(self) -> bool:
        """Whether the mesh is the requested one."""
        return self.number + 1 == self.count

    @property
    def steps(self) -> int:
        """Steps of descent."""
        return next((steps for points, steps in STEPS if self.points <= points), STEPS_BEYOND)

    @property
    def gauss_points(self) -> int:
        """Gauss points a direction and cell."""
        return next((count for points, count in GAUSS_POINTS if self.points <= points), GAUSS_POINTS_BEYOND)


@dataclass(frozen=True, kw_only=True)
class GridLevel(Level):
    """One of the nested grids."""

    grid: Grid

    @property
    def points(self) -> int:
        """Number of nodes."""
        return self.grid.points


AnyLevel = TypeVar("AnyLevel", bound=Level)


def nested_levels(grid: Grid) -> list[GridLevel]:
    """The levels up to ``grid``. The coarsest has about as many points in both directions, whatever the grid has."""
    halvings = [max(0, round(math.log2((n - 1) / COARSEST_CELLS))) for n in grid.shape]
    count = max(halvings) + 1
    levels = []
    for number in range(count):
        cells = [
            max(3, round((n - 1) / 2 ** max(halved - number, 0)))
            for n, halved in zip(grid.shape, halvings, strict=True)
        ]
        levels.append(GridLevel(number=number, count=count, grid=Grid(n_xi=cells[0] + 1, n_eta=cells[1] + 1)))
    return levels


def last_compared(levels: Sequence[Level]) -> int:
    """The number of the finest level up to which the descents from all starts run."""
    return max((level.number for level in levels if level.points <= MAX_COMPARED_POINTS), default=0)


def coarse_level(levels: Sequence[AnyLevel]) -> AnyLevel:
    """The level on which weights and monitors are compared: one of those on which a solve begins."""
    first, *finer = levels
    return next((level for level in reversed(finer) if level.points <= MAX_COARSE_POINTS), first)
