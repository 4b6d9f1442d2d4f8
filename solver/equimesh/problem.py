"""What is asked for: a monitor, a grid, and what places the nodes on the boundary."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.boundary import Boundary, sides
from equimesh.equations import MeshEquations
from equimesh.grid import Grid
from equimesh.monitor import ArcLength


@dataclass(frozen=True, kw_only=True)
class Problem:
    """A mesh of the unit square: locally equidistributed in the metric of ``monitor``, on the points of ``grid``."""

    monitor: ArcLength
    grid: Grid
    boundary: Boundary = Boundary.TRACE

    def equations(self) -> MeshEquations:
        """The discrete equations of the whole grid: the single-domain problem."""
        return MeshEquations(
            self.monitor,
            self.grid.shape,
            (self.grid.d_xi, self.grid.d_eta),
            list(sides(self.boundary).values()),
        )
