"""Problems whose rounding errors are as large as what they are to resolve."""

from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import smallest_residual
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.steps import Mode
from equimesh.solving import remedies
from equimesh.solving.solution import Solution
from equimesh.solving.status import Status

# Residual that rounding alone may cause. With a larger one a mesh is no solution, however small its residual is.
MAX_ROUNDING_RESIDUAL = 1e-2


def is_lost_in_rounding(problem: Problem) -> bool:
    """Whether rounding errors of u alone cause a residual that is too large for a solution."""
    return smallest_residual(problem.metric, problem.grid.shape) > MAX_ROUNDING_RESIDUAL


def solution_lost_in_rounding(problem: Problem, schwarz: Schwarz | None, mode: Mode) -> Solution:
    """The failed solve of a problem that is lost in rounding: the uniform mesh, and the reason."""
    uniform = Mesh.uniform(problem.grid)
    floor = smallest_residual(problem.metric, problem.grid.shape)
    return Solution(
        problem=problem,
        schwarz=schwarz,
        mesh=map_mesh(uniform, problem.domain),
        reference=uniform,
        status=Status.NEWTON_FAILED,
        mode=mode if schwarz is None else None,
        newton_steps=0,
        residual=floor,
        note=(
            f"u is {problem.metric.cancellation:.0e} times as large as it varies: rounding errors of its values alone"
            f" cause a residual of up to {floor:.0e}."
        ),
        remedy=remedies.after_rounding(),
    )
