"""The record of one step of a least-error solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from equimesh.inputs import finite_or_none
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh


@dataclass(frozen=True, kw_only=True)
class Descent:
    """The record of one step of descent. The mesh is one of the reference square."""

    level: int
    """The number of the nested grid, 0 for the coarsest."""
    levels: int
    """How many nested grids there are."""
    grid: Grid
    """The grid of the level."""
    step: int
    """The number of the step on its level, 0 for its first mesh."""
    steps: int
    """How many steps the level has at most."""
    error: float
    """The norm of the interpolation error, by the quadrature of the level."""
    gain: float | None
    """The error of the uniform mesh of the same grid over ``error``; ``None`` on fine grids, where it takes long."""
    distortion: float
    """The mean distortion of the cells relative to the first mesh of the way, 0 for that mesh."""
    min_jacobian: float
    """The smallest Jacobian of a corner on the domain, relative to the uniform mesh."""
    mesh: Mesh
    """The mesh of the reference square."""
    start: str
    """The first mesh of the way: ``"uniform"``, ``"rectilinear"`` or ``"given"``."""
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    def numbers(self) -> dict[str, Any]:
        """The record without the mesh, as plain Python data, ready for JSON."""
        return {
            "level": self.level,
            "grid": [self.grid.n_xi, self.grid.n_eta],
            "start": self.start,
            "step": self.step,
            **{name: finite_or_none(getattr(self, name)) for name in ("error", "gain", "distortion", "min_jacobian")},
        }
