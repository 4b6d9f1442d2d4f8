"""The single-domain mesh, by nested iteration from the uniform mesh on a coarse grid to the finest grid.

Every level is solved by the chord iteration. The coarsest level starts from the uniform mesh, a finer one from the
coarser solution. Where the coarsest level does not converge, a solve for half the monitor gives a better start. Where
that fails, too, the same is tried on grids with like numbers of points in both directions, if the requested one has
others. There Newton's method and continuation take over.
"""

import math
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np

from equimesh.equations.newton_solve import newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import distance, is_refined, nested_grids, prolong, refinement, square_grids
from equimesh.numerics.types import Array
from equimesh.single_domain import continuation
from equimesh.single_domain.continuation import NONE
from equimesh.single_domain.level import Level
from equimesh.single_domain.steps import Mode, Step, Steps
from equimesh.sweeps.deviation import deviation
from equimesh.sweeps.sweep import memory_needed

# On grids of up to this many points relaxed equations are solved. Finer ones take the interpolated mesh.
MAX_RELAXED_POINTS = 513 * 513
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
    if start is not None or not sweeps:
        grids = [problem.grid] if start is not None else nested_grids(problem.grid)
        yield from _Climb(problem, mode, threads, grids).by_newton(start)
        return
    grids, square = nested_grids(problem.grid), square_grids(problem.grid)
    solved = yield from _Climb(problem, mode, threads, grids).by_sweeps(only_requested=square != grids)
    if solved is None:
        yield from _Climb(problem, mode, threads, square).by_sweeps(only_requested=False)


class _Climb:
    """The levels of one nested iteration, and the last two solutions."""

    def __init__(self, problem: Problem, mode: Mode, threads: int, grids: list[Grid]) -> None:
        self._problem, self._mode, self._threads, self._grids = problem, mode, threads, grids
        self._solved: list[Step] = []

    def by_newton(self, start: Mesh | None) -> Iterator[Step]:
        """Newton's method on all levels, the first one from ``start``."""
        for level, grid in enumerate(self._grids):
            here, label = self._problem.on_grid(grid), self._label(level)
            label = label if start is None else replace(label, mesh=start)
            last = yield from _newton_level(here, label, self._before, plain=True, rough=False)
            yield last
            if last.failed:
                return
            self._solved = [*self._solved[-1:], last]

    def by_sweeps(self, *, only_requested: bool) -> Steps:
        """Sweeps, and Newton's method where they fail; returns the last step.

        ``None`` is returned where ``only_requested`` equations may be solved, and some level has no solution of them.
        """
        memory = np.empty(memory_needed(self._problem.grid.shape))
        last: Step | None = None
        for level, grid in enumerate(self._grids):
            here = self._problem.on_grid(grid)
            last = yield from self._sweeps(here, self._label(level), memory)
            if last is None and only_requested:
                return None
            if last is None:  # sweeps have overwritten the first guess
                rough = level + 1 < len(self._grids)
                last = yield from _newton_level(here, self._label(level), self._before, plain=False, rough=rough)
            yield last
            if last.failed:
                break
            self._solved = [*self._solved[-1:], last]
        return last

    @property
    def _before(self) -> Step | None:
        return self._solved[-1] if self._solved else None

    def _label(self, level: int) -> Step:
        """The record with which a level begins: its mesh is interpolated from the coarser levels."""
        grid = self._grids[level]
        guess = guess_on(grid, self._solved, self._threads) if self._solved else Mesh.uniform(grid)
        return Step(level=level, levels=len(self._grids), grid=grid, step=0, residual=math.nan, mesh=guess)

    def _sweeps(self, problem: Problem, label: Step, memory: Array) -> Steps:
        """The sweeps of one level; ``None`` where they do not converge, or the coarser level is relaxed."""
        before = self._before
        if before is not None and not before.relaxation.is_none:
            return None
        known = before is not None and is_refined(problem.grid, before.grid)  # the grid's error can be estimated
        tight = label.level + 1 == label.levels and (self._mode is Mode.TIGHT or not known)
        last = yield from Level(problem, label, before, tight, memory, self._threads).steps()
        if last is None and before is None:
            label = replace(label, mesh=Mesh.uniform(problem.grid))
            rough = yield from _weaker(problem, label, memory, self._threads)
            if rough is not None:
                label = replace(label, mesh=rough.mesh)
                last = yield from Level(problem, label, None, tight, memory, self._threads).steps()
        return last


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


def guess_on(grid: Grid, solved: list[Step], threads: int = 1) -> Mesh:
    """The last solution on a finer grid, extrapolated from the last two where they solve the same equations."""
    last = solved[-1]
    same = len(solved) > 1 and solved[-2].relaxation == last.relaxation and is_refined(grid, last.grid)
    return prolong(last.mesh, grid, solved[-2].mesh if same else None, threads=threads)


def _newton_level(
    problem: Problem, label: Step, before: Step | None, *, plain: bool, rough: bool
) -> Generator[Step, None, Step]:
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
    if before is None or problem.grid.points <= MAX_RELAXED_POINTS:
        found = yield from _label_steps(continuation.attempts(problem, label.mesh, relaxation, rough=rough), label)
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
