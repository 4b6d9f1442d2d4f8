"""The single-domain mesh, by nested iteration from the uniform mesh on a coarse grid to the finest grid.

Every level is solved by the chord iteration. The coarsest level starts from the uniform mesh, a finer one from the
coarser solution. Where the coarsest level does not converge, a solve for half the monitor gives a better start. Where
that fails, Newton's method and continuation take over.
"""

import math
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np

from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import distance, is_refined, nested_grids, prolong, refinement
from equimesh.numerics.types import Array
from equimesh.single_domain import continuation
from equimesh.single_domain.continuation import NONE
from equimesh.single_domain.level import Level
from equimesh.single_domain.steps import Mode, Step, Steps
from equimesh.sweeps.sweep import deviation, memory_needed

# The strength of the monitor that gives a start where the sweeps do not converge from the uniform mesh.
LEADING_STRENGTH = 0.5
# A mesh of at most this relative deviation satisfies the requested equations, even if relaxed ones were solved.
MAX_EXACT_DEVIATION = 1e-8


def single_domain_steps(
    problem: Problem, start: Mesh | None = None, *, mode: Mode = Mode.TIGHT, sweeps: bool = True, threads: int = 1
) -> Iterator[Step]:
    """Sweeps and Newton steps up the nested grids to the single-domain solution.

    ``start`` is a mesh of the problem's own grid: Newton's method then begins there, without nested iteration.
    ``sweeps=False`` uses Newton's method on all levels: a reference, hundreds of times slower on fine grids. The last
    step has ``converged`` or ``failed`` set; its mesh is valid in any case.
    """
    grids = [problem.grid] if start is not None else nested_grids(problem.grid)
    memory = np.empty(memory_needed(problem.grid.shape)) if sweeps and start is None else np.empty(0)
    solved: list[Step] = []
    for level, grid in enumerate(grids):
        here = replace(problem, grid=grid)
        guess = start or (guess_on(grid, solved) if solved else Mesh.uniform(grid))
        label = Step(level=level, levels=len(grids), grid=grid, step=0, residual=math.nan, mesh=guess)
        before = solved[-1] if solved else None
        last: Step | None = None
        if sweeps and start is None and (before is None or before.relaxation.is_none):
            known = before is not None and is_refined(grid, before.grid)  # then the grid's error can be estimated
            tight = level + 1 == len(grids) and (mode is Mode.TIGHT or not known)
            last = yield from Level(here, label, before, tight, memory, threads).steps()
            if last is None and before is None:
                rough = yield from _weaker(here, replace(label, mesh=Mesh.uniform(grid)), memory, threads)
                if rough is not None:
                    label = replace(label, mesh=rough.mesh)
                    last = yield from Level(here, label, None, tight, memory, threads).steps()
        if last is None:
            plain = not sweeps or start is not None
            if start is None and solved:
                label = replace(label, mesh=guess_on(grid, solved))  # sweeps have overwritten the first guess
            elif start is None:
                label = replace(label, mesh=Mesh.uniform(grid))
            last = yield from _newton_level(here, label, before, plain=plain)
        yield last
        if last.failed:
            return
        solved = [*solved[-1:], last]


def _weaker(problem: Problem, label: Step, memory: Array, threads: int) -> Steps:
    """Sweeps from the uniform mesh for half the monitor; ``None`` where these do not converge, either.

    A sweep for a steep front overshoots from the uniform mesh, but seldom from the mesh of half the monitor.
    """
    weak = replace(problem, monitor=problem.monitor.weakened(LEADING_STRENGTH))
    label = replace(label, relaxation=continuation.Relaxation(strength=LEADING_STRENGTH))
    return (yield from Level(weak, label, None, False, memory, threads).steps())


def steps_from(problem: Problem, start: Mesh, *, threads: int = 1) -> Iterator[Step]:
    """Sweeps to a tight tolerance from a mesh near the solution, such as that of a monitor a time step earlier.

    Where they do not converge, the steps of :func:`single_domain_steps` without a start.
    """
    own = Mesh(start.x.copy(), start.y.copy())
    label = Step(level=0, levels=1, grid=problem.grid, step=0, residual=math.nan, mesh=own)
    memory = np.empty(memory_needed(problem.grid.shape))
    last = yield from Level(problem, label, None, True, memory, threads).steps()
    if last is None:
        yield from single_domain_steps(problem, mode=Mode.TIGHT, threads=threads)
    else:
        yield last


def guess_on(grid: Grid, solved: list[Step]) -> Mesh:
    """The last solution on a finer grid, extrapolated from the last two where they solve the same equations."""
    last = solved[-1]
    same = len(solved) > 1 and solved[-2].relaxation == last.relaxation
    return prolong(last.mesh, grid, solved[-2].mesh if same else None)


def _newton_level(problem: Problem, label: Step, before: Step | None, *, plain: bool) -> Generator[Step, None, Step]:
    """Newton's method and continuation from the label's mesh."""
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
    if before is None or problem.grid.points <= MAX_FACTORISED_POINTS:
        found = yield from _label_steps(continuation.attempts(problem, label.mesh, relaxation), label)
    if found is None and before is not None:
        solved = before.solved or before.grid
        return replace(label, relaxation=relaxation, residual=math.nan, converged=True, solved=solved)
    if found is None:
        raise AssertionError("on the first level continuation always returns an attempt")
    step = replace(label, step=found.steps, residual=found.residual, mesh=found.mesh, relaxation=found.relaxation)
    if not step.relaxation.is_none and deviation(problem.metric, problem.boundary, found.mesh) < MAX_EXACT_DEVIATION:
        step = replace(step, relaxation=NONE)  # the cross-line term vanishes on straight lines
    return _with_errors(replace(step, converged=found.converged, failed=not found.converged), before)


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
