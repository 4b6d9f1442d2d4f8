"""The records of the steps of a single-domain solve, and its modes."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self, TypeAlias

from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.single_domain.continuation import NONE, Relaxation

# Relative deviation of squared metric lengths from the mean of their line, in tight mode.
TIGHT_DEVIATION = 1e-10
# Algebraic error that is left otherwise, as a share of the discretisation error.
ALGEBRAIC_SHARE = 0.2


class Mode(StrEnum):
    """When a single-domain solve ends.

    ``DISCRETIZATION``: when further iterations would change the mesh by no more than a fifth of the error of the grid.
    ``TIGHT``: when squared metric lengths differ from the mean of their line by at most 1e-10 of it; for studies and
    references.
    """

    DISCRETIZATION = "discretization"
    TIGHT = "tight"


@dataclass(frozen=True, kw_only=True)
class Step:
    """The record of one sweep or Newton step of a single-domain solve. Lengths are in units of the reference square."""

    level: int
    """The number of the nested grid, 0 for the coarsest."""
    levels: int
    """How many nested grids there are."""
    grid: Grid
    """The grid of the level."""
    step: int
    """The number of the step on its level."""
    residual: float
    """A relative residual before a sweep or after a Newton step.

    For a sweep it is the largest deviation of a squared metric length from the mean of its line. For a Newton step it
    is the largest defect over the mean flux.
    """
    mesh: Mesh
    """The mesh of the reference square."""
    relaxation: Relaxation = NONE
    """The difference between the requested equations and those that the step solves."""
    converged: bool = False
    """Whether this is the last step of its level, and the mesh solves the equations of ``relaxation``."""
    failed: bool = False
    """Whether the solve ended without a mesh that solves any of the equations tried."""
    algebraic_error: float = math.nan
    """Estimated error from stopping the iteration, NaN where not known."""
    discretization_error: float = math.nan
    """Estimated error of the grid, NaN where not known."""
    solved: Grid | None = None
    """The coarser grid on which the equations were solved, where ``grid`` was too fine for relaxed ones."""
    contraction: float = 1.0
    """The factor by which sweeps reduce their moves, 1 where not known."""
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    def snapshot(self) -> Self:
        """The step with its own copy of the mesh, which later sweeps of the level would overwrite."""
        if self.converged or self.failed:
            return self
        return replace(self, mesh=Mesh(self.mesh.x.copy(), self.mesh.y.copy()))

    @property
    def is_exact(self) -> bool:
        """Whether the mesh solves the requested equations on its own grid."""
        return self.converged and self.relaxation.is_none and self.solved is None

    @property
    def strength(self) -> float:
        """The strength of the monitor, 1 for the requested one."""
        return self.relaxation.strength


Steps: TypeAlias = Generator[Step, None, Step | None]
