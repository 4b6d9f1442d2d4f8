"""The record of one step of a least-error solve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from equimesh.inputs import finite_or_none
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh


@dataclass(frozen=True, kw_only=True)
class Descent:
    """The record of one step of descent. The mesh is one of the reference square, or of a domain in blocks."""

    level: int
    """The number of the nested grid, 0 for the coarsest."""
    levels: int
    """How many nested grids there are."""
    grid: Grid | None
    """The grid of the level; ``None`` on a domain in blocks, whose meshes have none."""
    step: int
    """The number of the step on its level, 0 for its first mesh."""
    steps: int
    """How many steps the level has at most."""
    error: float
    """The norm of the interpolation error, by the quadrature of the level."""
    gain: float | None
    """The error of the uniform or initial mesh over ``error``; ``None`` on fine grids, where it takes long."""
    distortion: float
    """The mean distortion of the cells relative to the first mesh of the way, 0 for that mesh."""
    min_jacobian: float
    """The smallest Jacobian of a corner on the domain, relative to the uniform mesh.

    On a domain in blocks relative to the same corner of the initial mesh.
    """
    mesh: Mesh | QuadMesh
    """The mesh of the reference square, or that of the domain in blocks."""
    start: str
    """The first mesh: ``"uniform"``, ``"rectilinear"`` or ``"given"``; on a domain in blocks ``"initial"``."""
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    @property
    def points(self) -> int:
        """Points of the level."""
        return int(self.mesh.x.size)

    def numbers(self) -> dict[str, Any]:
        """The record without the mesh, as plain Python data, ready for JSON."""
        return {
            "level": self.level,
            **({"points": self.points} if self.grid is None else {"grid": [self.grid.n_xi, self.grid.n_eta]}),
            "start": self.start,
            "step": self.step,
            **{name: finite_or_none(getattr(self, name)) for name in ("error", "gain", "distortion", "min_jacobian")},
        }
