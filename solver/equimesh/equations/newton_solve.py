"""Guarded Newton solves of one set of mesh equations: a subdomain's, or those of a whole grid."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.numerics import newton

# Rounding errors: of positions, of the moves of a sweep, and of residuals.

# Changes of a coordinate that rounding alone can cause, per point in a direction.
POSITION_ROUNDING = 1e-13
# The additional change per point, for each multiple of its variation by which u is larger.
CANCELLED_ROUNDING = 1e-14
# Moves of a coordinate that rounding alone causes in one sweep, per point in a direction.
MOVE_ROUNDING = 1e-15
# Relative residuals that rounding alone causes, per point in a direction.
RESIDUAL_ROUNDING = 64 * np.finfo(np.float64).eps


def smallest_tolerance(problem: Problem) -> float:
    """The rounding error of a node position. No smaller tolerance can be met."""
    return max(problem.grid.shape) * (POSITION_ROUNDING + CANCELLED_ROUNDING * (problem.metric.cancellation - 1.0))


def smallest_move(shape: tuple[int, int]) -> float:
    """The move of a coordinate that rounding alone causes in a sweep. Smaller moves do not fall any more."""
    return MOVE_ROUNDING * max(shape)


def smallest_residual(metric: ReferenceMetric, shape: tuple[int, int]) -> float:
    """The rounding error of a relative residual on a grid: larger where u varies little compared with its size."""
    return float(RESIDUAL_ROUNDING * max(shape) * metric.cancellation)


# Newton steps of one solve.
MAX_STEPS = 60
# Grids and windows of up to this many points are factorised where sweeps fail. Larger ones would take minutes.
MAX_FACTORISED_POINTS = 257 * 257
# The residual of a solution, relative to the mean flux.
TOLERANCE = 1e-12


@dataclass(frozen=True)
class NewtonSolution:
    """The end of a guarded Newton solve: the residual relative to the mean flux, and whether it met the tolerance.

    ``swept`` is set where the steps were sweeps of line corrections.
    """

    mesh: Mesh
    steps: int
    residual: float
    converged: bool
    swept: bool = False


def newton_steps(
    equations: MeshEquations,
    start: Mesh,
    tolerance: float = TOLERANCE,
    most_steps: int = MAX_STEPS,
    *,
    fast: bool = False,
) -> Iterator[NewtonSolution]:
    """Guarded Newton steps for one set of mesh equations, never through a folded mesh.

    ``tolerance`` is relative to the mean flux, and is raised to the rounding error of the grid where it is smaller.
    ``fast`` eliminates the nodes by nested dissection and reuses a factorisation while it reduces the residual well.
    Without it every step is a plain Newton step with SuperLU's default ordering.
    """
    z = equations.vector(start)
    unit = equations.mean_flux(z)
    floor = smallest_residual(equations.metric, equations.shape)
    steps = newton.newton_iterations(
        equations.residual,
        equations.jacobian,
        z,
        admissible=lambda candidate: not equations.mesh(candidate).is_folded,
        tolerance=max(tolerance, floor) * unit,
        factorise=(lambda matrix: newton.factorise(matrix, equations.shape)) if fast else newton.superlu,
        reuse=fast,
    )
    for record in steps:
        met = record.residual <= max(tolerance, floor) * unit
        yield NewtonSolution(equations.mesh(record.z), record.step, record.residual / unit, met)
        if record.step >= most_steps:
            return
