"""The single-domain solve of a metric, also on closed lines, and how it ends."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypedDict

import numpy as np

from equimesh.domains.domain import is_closed, map_mesh
from equimesh.equations.newton_solve import smallest_residual
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.gradient_map import gradient_map_steps
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import prolong
from equimesh.monitors.metrics import ArcLength
from equimesh.monitors.monitor import map_of
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain import iteration
from equimesh.single_domain.level import Mode, Step
from equimesh.solving.certificate import safe_algebraic_error, safe_discretization_error
from equimesh.solving.solution import Solution, status_unless_folded
from equimesh.solving.status import (
    Initial,
    SolveOptions,
    Status,
    SweepProgress,
    after_mapping,
    after_newton,
    after_rounding,
)
from equimesh_schema import Relaxed

# Problems whose rounding errors are as large as what they are to resolve.

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
        remedy=after_rounding(),
    )


# Checks of problems on grids with closed lines.

NO_SUBDOMAINS = (
    "the lines of this domain are closed, and the subdomains of a Schwarz iteration end at sides: leave the Schwarz"
    " settings out, or take a domain without closed lines"
)
"""The reason why closed lines with Schwarz settings are refused."""
NO_GRADIENT_MAP = (
    "the gradient map of a weight needs four sides, and the lines of this domain are closed: take map = 'lines'"
)
"""The reason why closed lines with a gradient map are refused."""


def require_open(problem: Problem, schwarz: Schwarz | None) -> None:
    """Raises :class:`~equimesh.errors.InputError` for Schwarz settings and a gradient map on closed lines."""
    if not is_closed(problem.domain):
        return
    if schwarz is not None:
        raise InputError(NO_SUBDOMAINS, field="schwarz")
    if map_of(problem.monitor) != "lines":
        raise InputError(NO_GRADIENT_MAP, field="monitor.map")


class Outcome(TypedDict):
    """The end of a single-domain solve; its fields are fields of :class:`~equimesh.solving.solution.Solution`."""

    status: Status
    newton_steps: int
    residual: float
    note: str
    remedy: str
    relaxed: tuple[Relaxed, ...]
    algebraic_error: float | None
    discretization_error: float | None


def solve_single_domain(
    problem: Problem, initial: Initial | Mesh, options: SolveOptions, mode: Mode, *, allow_relaxed: bool
) -> Solution:
    """The mesh of a single-domain solve, of the requested equations or of relaxed ones."""
    step = last_step(problem, initial, options, mode)
    nested = initial is not Initial.UNIFORM
    return solution_of(step, problem, options, mode, allow_relaxed=allow_relaxed, nested=nested)


def solution_of(
    step: Step, problem: Problem, options: SolveOptions, mode: Mode, *, allow_relaxed: bool, nested: bool = True
) -> Solution:
    """The solution that ends with a step."""
    reference = _on_grid(step.mesh, problem)
    mesh = map_mesh(reference, problem.domain)
    folded = mesh.is_folded_on(options.threads)
    return Solution(
        problem=problem,
        schwarz=None,
        mesh=mesh,
        reference=reference,
        mode=None if map_of(problem.monitor) == "gradient" else mode,
        **outcome(step, problem, allow_relaxed=allow_relaxed, folded=folded, nested=nested),
    )


def outcome(step: Step, problem: Problem, *, allow_relaxed: bool, folded: bool, nested: bool = True) -> Outcome:
    """The end of a solve, from its last step; ``folded`` tells whether the mesh of the domain is folded."""
    status = _status(step, allow_relaxed=allow_relaxed)
    exact = status is Status.CONVERGED
    return Outcome(
        status=status_unless_folded(status, folded=folded),
        newton_steps=step.step,
        residual=step.residual,
        note="" if exact else what_was_found(step, problem),
        remedy=_single_domain_remedy(step, problem, status, folded=folded, nested=nested),
        relaxed=_relaxed(step, problem),
        algebraic_error=safe_algebraic_error(step.algebraic_error),
        discretization_error=safe_discretization_error(step.discretization_error),
    )


def last_step(problem: Problem, initial: Initial | Mesh, options: SolveOptions, mode: Mode) -> Step:
    """The last step of a single-domain solve from its ``initial`` mesh, on which a gradient map does not depend."""
    if map_of(problem.monitor) == "gradient":
        return last_of(gradient_map_steps(problem), options, SweepProgress(doing="solving for the map"))
    if isinstance(initial, Mesh):
        steps = iteration.steps_from(problem, initial, mode=mode, threads=options.threads)
        return last_of(steps, options, SweepProgress(mode=mode))
    if initial is Initial.UNIFORM:
        return last_of_newton(problem, Mesh.uniform(problem.grid), options, mode)
    steps = iteration.single_domain_steps(problem, mode=mode, threads=options.threads)
    return last_of(steps, options, SweepProgress(mode=mode))


def last_of_newton(problem: Problem, start: Mesh, options: SolveOptions, mode: Mode) -> Step:
    """The last step of Newton's method from a mesh of the problem's grid."""
    steps = iteration.single_domain_steps(problem, start, mode=mode, threads=options.threads)
    return last_of(steps, options, SweepProgress(doing="Newton's method"))


def last_of(steps: Iterable[Step], options: SolveOptions, course: SweepProgress) -> Step:
    """The last step, after all steps were reported to the observer."""
    step, telling = None, options.part(course=course)
    for step in steps:
        telling.observe(step)
    if step is None:
        raise AssertionError("a single-domain solve yields at least its start")
    return step


def _single_domain_remedy(step: Step, problem: Problem, status: Status, *, folded: bool, nested: bool) -> str:
    if folded:
        return after_mapping()
    exact = status is Status.CONVERGED
    return "" if exact else after_newton(problem, nested=nested, reached=step.strength)


def _status(step: Step, *, allow_relaxed: bool) -> Status:
    if step.is_exact:
        return Status.CONVERGED
    relaxed = allow_relaxed and step.converged and step.strength > 0.0
    return Status.RELAXED if relaxed else Status.NEWTON_FAILED


def _relaxed(step: Step, problem: Problem) -> tuple[Relaxed, ...]:
    """The differences between the requested equations and those that the mesh satisfies."""
    found, monitor = [], problem.monitor
    if step.strength < 1.0:
        what, requested = ("a", monitor.a) if isinstance(monitor, ArcLength) else ("strength", 1.0)
        found.append(Relaxed(what=what, asked=requested, reached=step.strength * requested))
    if step.relaxation.cross_line > 0.0:
        found.append(Relaxed(what="cross_line", asked=0.0, reached=step.relaxation.cross_line))
    if step.solved is not None and step.solved != problem.grid:
        found.append(Relaxed(what="points", asked=max(problem.grid.shape), reached=max(step.solved.shape)))
    return tuple(found)


def _on_grid(mesh: Mesh, problem: Problem) -> Mesh:
    """The mesh on the problem's grid, also where the solve ended on a coarser one."""
    return mesh if mesh.x.shape == problem.grid.shape else prolong(mesh, problem.grid)


def what_was_found(step: Step, problem: Problem) -> str:
    """A sentence about the equations that the mesh satisfies, where these are not the requested ones."""
    requested, name = (problem.monitor.a, "a") if isinstance(problem.monitor, ArcLength) else (1.0, "strength")
    where = "" if step.grid == problem.grid else f" on the {step.grid} grid"
    if step.failed or step.strength == 0.0:
        slopes = problem.metric.u_with_gradient(step.mesh.x, step.mesh.y)
        reason = "" if np.isfinite(slopes).all() else " The gradient of u is not finite everywhere on the domain."
        return f"No mesh was found{where} that satisfies any of the equations tried, down to {name} = 0.{reason}"
    found = [f"{name} = {step.strength * requested:.3g} of {requested:.3g}"] if step.strength < 1.0 else []
    if step.relaxation.cross_line > 0.0:
        found.append(f"a cross-line term of weight {step.relaxation.cross_line:g}")
    added = f" with {' and '.join(found)}" if found else ""
    if step.solved is not None and step.solved != problem.grid:
        return f"A mesh of {step.solved} points satisfies the equations{added}; this one is interpolated from it."
    return f"The mesh satisfies the equations{added}{where}."
