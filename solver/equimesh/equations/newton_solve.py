"""Guarded Newton solves of one set of mesh equations: a subdomain's, or those of a whole grid."""

from collections.abc import Iterator
from dataclasses import dataclass

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.rounding import smallest_residual
from equimesh.meshes.mesh import Mesh
from equimesh.numerics import dissection, newton

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
        factorise=(lambda matrix: dissection.factorise(matrix, equations.shape)) if fast else newton.superlu,
        reuse=fast,
    )
    for record in steps:
        met = record.residual <= max(tolerance, floor) * unit
        yield NewtonSolution(equations.mesh(record.z), record.step, record.residual / unit, met)
        if record.step >= most_steps:
            return
