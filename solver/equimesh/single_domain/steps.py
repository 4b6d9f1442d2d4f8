"""Steps of a single-domain solve: the records, and how exact it is."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.single_domain.continuation import NONE, Relaxation

# Relative deviation of squared metric lengths from the mean of their line, in tight mode.
TIGHT_DEVIATION = 1e-10
# Algebraic error that is left otherwise, as a share of the discretisation error.
ALGEBRAIC_SHARE = 0.2


class Mode(StrEnum):
    """When a solve is done.

    ``DISCRETIZATION``: when what iterating on would change is a fifth of the error that the grid makes anyway.
    ``TIGHT``: when squared metric lengths differ from the mean of their line by 1e-10 of it; for studies, and for
    references to compare with.
    """

    DISCRETIZATION = "discretization"
    TIGHT = "tight"


@dataclass(frozen=True, kw_only=True)
class Step:
    """One sweep or Newton step of a single-domain solve.

    ``level`` of ``levels`` is the grid of the nested iteration (0 the coarsest). ``relaxation`` is what the equations
    that the step solves differ by from the asked ones. ``residual`` is relative: of a sweep, the largest deviation of a
    squared metric length from the mean of its line; of a Newton step, the largest defect over the mean flux.
    ``mesh`` is that of the reference square.

    ``converged`` is set by the last step of every level, and says that the mesh solves the equations of ``relaxation``
    there; ``failed`` where no mesh was found that solves any. ``algebraic_error`` and ``discretization_error`` are
    estimates in units of the reference square, NaN where not known. ``solved`` is the grid on which the equations were
    solved, coarser than ``grid`` where relaxed ones would have been too costly on that; ``contraction`` the factor by
    which sweeps shrank their moves, 1 where it is not known.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    mesh: Mesh
    relaxation: Relaxation = NONE
    converged: bool = False
    failed: bool = False
    algebraic_error: float = math.nan
    discretization_error: float = math.nan
    solved: Grid | None = None
    contraction: float = 1.0

    def snapshot(self) -> Step:
        """The step with a mesh of its own: sweeps that follow overwrite the mesh of one that does not end a level."""
        if self.converged or self.failed:
            return self
        return replace(self, mesh=Mesh(self.mesh.x.copy(), self.mesh.y.copy()))

    @property
    def is_exact(self) -> bool:
        """Whether the mesh solves the asked equations on its own grid."""
        return self.converged and self.relaxation.is_none and self.solved is None

    @property
    def strength(self) -> float:
        """The strength of the monitor, 1 for the asked one."""
        return self.relaxation.strength


Steps: TypeAlias = Generator[Step, None, Step | None]
