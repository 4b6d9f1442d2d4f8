"""Newton's method and continuation on one level, where sweeps find no solution."""

import math
from collections.abc import Generator
from dataclasses import replace

from equimesh.equations.newton_solve import newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import distance, is_refined, refinement
from equimesh.single_domain import continuation
from equimesh.single_domain.continuation import NONE
from equimesh.single_domain.steps import Step
from equimesh.sweeps.deviation import deviation

# On grids of up to this many points relaxed equations are solved. Finer ones take the interpolated mesh.
MAX_RELAXED_POINTS = 513 * 513
# A mesh of at most this relative deviation satisfies the requested equations, even if relaxed ones were solved.
MAX_EXACT_DEVIATION = 1e-8


def newton_level(
    problem: Problem, label: Step, before: Step | None, *, plain: bool, rough: bool
) -> Generator[Step, None, Step]:
    """Newton's method and continuation from the label's mesh; the mesh of the label where the grid is too fine."""
    relaxation = NONE if before is None else before.relaxation
    if plain and relaxation.is_none:
        last = None
        for last in newton_steps(problem.equations(), label.mesh):
            mesh = Mesh.of_unit_square(last.mesh.x, last.mesh.y)
            step = replace(label, step=last.steps, residual=last.residual, mesh=mesh)
            if last.converged:
                return _with_errors(replace(step, converged=True), before)
            yield step
    found = None
    if before is None or problem.grid.points <= MAX_RELAXED_POINTS:
        found = yield from _label_steps(continuation.attempts(problem, label.mesh, relaxation, rough=rough), label)
    if found is None and before is not None:
        return interpolated_level(label, before)
    if found is None:
        raise AssertionError("on the first level continuation always returns an attempt")
    step = replace(label, step=found.steps, residual=found.residual, mesh=found.mesh, relaxation=found.relaxation)
    if not step.relaxation.is_none and deviation(problem.metric, problem.boundary, found.mesh) < MAX_EXACT_DEVIATION:
        step = replace(step, relaxation=NONE)  # the cross-line term vanishes on straight lines
    return _with_errors(replace(step, converged=found.converged, failed=not found.converged), before)


def interpolated_level(label: Step, before: Step) -> Step:
    """The end of a level that keeps the mesh with which it begins, that of the coarser level ``before``."""
    solved = before.solved or before.grid
    return replace(label, relaxation=before.relaxation, residual=math.nan, converged=True, solved=solved)


def _label_steps(attempts: continuation.Attempts, label: Step) -> Generator[Step, None, continuation.Attempt | None]:
    while True:
        try:
            found = next(attempts)
        except StopIteration as end:
            result: continuation.Attempt | None = end.value
            return result
        yield replace(label, step=found.steps, residual=found.residual, mesh=found.mesh, relaxation=found.relaxation)


def _with_errors(step: Step, before: Step | None) -> Step:
    """The step with error estimates, for a mesh that Newton's method solved to rounding."""
    if not step.converged:
        return step
    if before is None or before.relaxation != step.relaxation or not is_refined(step.grid, before.grid):
        return replace(step, algebraic_error=0.0)
    error = distance(step.mesh, before.mesh) / (refinement(step.grid, before.grid) - 1.0)
    return replace(step, algebraic_error=0.0, discretization_error=error)
