"""The single-domain mesh, by nested iteration from the uniform mesh on a coarse grid to the finest grid.

Every level is solved by the chord iteration. The coarsest level starts from the uniform mesh, a finer one from the
coarser solution. Where the coarsest level does not converge, a solve for half the monitor gives a better start. Where
that fails, too, the same is tried on grids with like numbers of points in both directions, if the requested one has
others. There Newton's method and continuation take over.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace

import numpy as np

from equimesh.domains.domain import closed_of, is_closed
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.nested import (
    Closed,
    closed_mesh,
    distance_closed,
    is_refined,
    nested_grids,
    padded,
    padded_shape,
    prolong,
    prolong_closed,
    prolong_rows,
    square_grids,
    unpadded,
)
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.level import (
    MAX_ERROR_FROM_MESH,
    MAX_SWEEPS,
    Level,
    LevelSolution,
    Mode,
    Step,
    Steps,
    newton_level,
)
from equimesh.sweeps.sweep import Frame, memory_needed

# The levels of a nested iteration, from coarse to fine.
#
# Every level begins with the mesh of the coarser ones, interpolated. Sweeps solve it. Where they do not converge,
# Newton's method and continuation take over, on grids that are not too fine for them; a finer grid keeps the
# interpolated mesh.

# The strength of the monitor that gives a start where the sweeps do not converge from the uniform mesh.
LEADING_STRENGTH = 0.5


class Climb:
    """The levels of one nested iteration, and the last two solutions, ``solved``."""

    def __init__(
        self, problem: Problem, mode: Mode, threads: int, grids: Sequence[Grid], solved: Sequence[LevelSolution] = ()
    ) -> None:
        self._problem, self._mode, self._threads, self._grids = problem, mode, threads, grids
        self.solved = list(solved)

    def by_newton(self, start: Mesh | None) -> Iterator[Step]:
        """Newton's method on all levels, the first one from ``start``."""
        for level, grid in enumerate(self._grids):
            here, label = self._problem.on_grid(grid), self._label(level)
            label = label if start is None else replace(label, mesh=start)
            before = None if self._before is None else self._before.step
            last = yield from newton_level(here, label, before, plain=True, rough=False)
            yield last
            if last.failed:
                return
            self._keep(last)

    def by_sweeps(self, *, only_requested: bool, levels: range | None = None) -> Steps:
        """Sweeps, and Newton's method where they fail, on these ``levels``, by default on all; returns the last step.

        ``None`` is returned where ``only_requested`` equations may be solved, and some level has no solution of them.
        """
        levels = range(len(self._grids)) if levels is None else levels
        here = (self._rows_of(self._grids[level]).here_shape for level in levels)
        memory = np.empty(max(map(memory_needed, here), default=0))
        last: Step | None = None
        for level in levels:
            problem = self._problem.on_grid(self._grids[level])
            last = yield from self._sweeps(problem, self._label(level), memory)
            if last is None and only_requested:
                return None
            if last is None:  # sweeps have overwritten the first guess
                last = yield from self._without_sweeps(problem, self._label(level))
            yield last
            if last.failed:
                break
            self._keep(last)
        return last

    def _rows_of(self, grid: Grid) -> Rows:
        """The rows of a grid that are here."""
        return Rows.whole(grid.shape, self._threads)

    def _keep(self, last: Step) -> None:
        self.solved = [*self.solved[-1:], LevelSolution.of(last, self._rows_of(last.grid))]

    @property
    def _before(self) -> LevelSolution | None:
        return self.solved[-1] if self.solved else None

    def _label(self, level: int) -> Step:
        """The record with which a level begins: its mesh is interpolated from the coarser levels."""
        grid = self._grids[level]
        if self.solved:
            guess = self._guess(self._rows_of(grid), is_extrapolated(grid, [known.step for known in self.solved]))
            mesh = Mesh(guess.x, guess.y)
        else:
            mesh = Mesh.uniform(grid)
        return Step(level=level, levels=len(self._grids), grid=grid, step=0, residual=math.nan, mesh=mesh)

    def _guess(self, rows: Rows, extrapolated: bool) -> MeshRows:
        """The mesh of the coarser levels on the grid of ``rows``."""
        return prolong_rows(self.solved[-1].mesh, self.solved[-2].mesh if extrapolated else None, rows)

    def _level(self, problem: Problem, label: Step, before: LevelSolution | None, tight: bool, memory: Array) -> Level:
        """The iteration on one level."""
        return Level(problem, label, before, tight, memory, self._rows_of(problem.grid))

    def _sweeps(self, problem: Problem, label: Step, memory: Array) -> Steps:
        """The sweeps of one level; ``None`` where they do not converge, or the coarser level is relaxed."""
        before = self._before
        if before is not None and not before.step.relaxation.is_none:
            return None
        known = before is not None and is_refined(problem.grid, before.grid)  # the grid's error can be estimated
        tight = label.level + 1 == label.levels and (self._mode is Mode.TIGHT or not known)
        last = yield from self._level(problem, label, before, tight, memory).steps()
        if last is None and before is None:
            label = replace(label, mesh=Mesh.uniform(problem.grid))
            rough = yield from self._weaker(problem, label, memory)
            if rough is not None:
                label = replace(label, mesh=rough.mesh)
                last = yield from self._level(problem, label, None, tight, memory).steps()
        return last

    def _weaker(self, problem: Problem, label: Step, memory: Array) -> Steps:
        """Sweeps from the uniform mesh for half the monitor; ``None`` where these do not converge, either.

        A sweep for a steep front overshoots from the uniform mesh, but seldom from the mesh of half the monitor.
        """
        weak = replace(problem, monitor=problem.monitor.weakened(LEADING_STRENGTH))
        label = replace(label, relaxation=Relaxation(strength=LEADING_STRENGTH))
        return (yield from self._level(weak, label, None, False, memory).steps())

    def _without_sweeps(self, problem: Problem, label: Step) -> Generator[Step, None, Step]:
        """A level on which sweeps find no solution."""
        before = None if self._before is None else self._before.step
        return (yield from newton_level(problem, label, before, plain=False, rough=label.level + 1 < label.levels))


def is_extrapolated(grid: Grid, solved: Sequence[Step]) -> bool:
    """Whether the mesh on a finer grid is extrapolated from the last two solutions, which solve equal equations."""
    return len(solved) > 1 and solved[-2].relaxation == solved[-1].relaxation and is_refined(grid, solved[-1].grid)


# Nested iteration where grid lines are closed: sweeps on every level.
#
# The equations of closed lines are solved by sweeps alone. Where these do not converge, the strength of the monitor is
# raised from 0 in adaptive steps, as far as they do.

# Relative deviation of squared metric lengths at which a tight solve ends: rounding, so that the mesh does not depend
# on where its lines begin.
TIGHT_DEVIATION = 1e-13
# The first step of the strength of the monitor, where sweeps do not converge for the whole of it, and the smallest one.
FIRST_ADVANCE = 0.5
MIN_ADVANCE = 1.0 / 64.0


class ClosedLevel(Level):
    """The chord iteration on one level, with copies of the nodes beyond the seams in its working memory."""

    @property
    def _closed(self) -> Closed:
        return closed_of(self.problem.domain)

    @property
    def _frame(self) -> Frame:
        return Frame.around(self._closed)

    @property
    def _most_sweeps(self) -> int:
        return MAX_SWEEPS

    @property
    def _tight_deviation(self) -> float:
        return TIGHT_DEVIATION

    def _start(self) -> tuple[Array, Array]:
        start = padded(self.label.mesh, self._closed)
        return start.x, start.y

    def _mesh(self, x: Array, y: Array) -> Mesh:
        return unpadded(x, y, self._closed)

    def _gap(self, x: Array, y: Array) -> float:
        if self.coarse is None or not is_refined(self.problem.grid, self.coarse.grid):
            return math.nan
        return distance_closed(self._mesh(x, y), self.coarse.step.mesh, self._closed)

    def _finished(self, step: Step, own: tuple[Array, Array], error: float) -> Step:
        del own  # it has copies beyond the seams
        mesh = closed_mesh(step.mesh, self._closed)
        return replace(step, mesh=mesh, converged=True, discretization_error=error)


class ClosedClimb:
    """The levels of a nested iteration of a problem with closed lines."""

    def __init__(self, problem: Problem, mode: Mode, threads: int) -> None:
        self._problem, self._mode, self._threads = problem, mode, threads
        self._closed = closed_of(problem.domain)
        self._grids = nested_grids(problem.grid)
        self._solved: list[Step] = []
        shape = padded_shape(problem.grid.shape, self._closed)
        self._memory = np.empty(memory_needed(shape))

    def steps(self, start: Mesh | None) -> Iterator[Step]:
        """Sweeps on all levels; with ``start``, a mesh of the problem's grid, on the finest one alone."""
        grids = self._grids if start is None else [self._problem.grid]
        for level, grid in enumerate(grids):
            label = Step(
                level=level,
                levels=len(grids),
                grid=grid,
                step=0,
                residual=math.nan,
                mesh=self._guess(grid) if start is None else start,
            )
            problem = self._problem.on_grid(grid)
            last = yield from self._requested(problem, label)
            if last is None:
                last = yield from self._weaker(problem, replace(label, mesh=self._guess(grid)))
            yield last
            self._solved.append(last)

    def steps_from(self, start: Mesh) -> Iterator[Step]:
        """Sweeps to a tight tolerance from a mesh near the solution; nested ones where these do not converge."""
        label = Step(level=0, levels=1, grid=start.grid, step=0, residual=math.nan, mesh=start)
        last = yield from self._level(self._problem, label, None, tight=True)
        if last is None:
            yield from self.steps(None)
        else:
            yield last

    def _guess(self, grid: Grid) -> Mesh:
        """The mesh of the coarser levels on ``grid``, the uniform mesh on the first one."""
        if not self._solved:
            return Mesh.uniform(grid)
        last, before = self._solved[-1], self._solved[-2] if len(self._solved) > 1 else None
        is_like = before is not None and before.relaxation == last.relaxation and is_refined(last.grid, before.grid)
        coarser = before.mesh if before is not None and is_like and is_refined(grid, last.grid) else None
        return prolong_closed(last.mesh, grid, self._closed, coarser)

    def _requested(self, problem: Problem, label: Step) -> Steps:
        """The sweeps of one level; ``None`` where they do not converge, or where the coarser level is relaxed."""
        before = self._solved[-1] if self._solved else None
        if before is not None and not before.relaxation.is_none:
            return None
        return (yield from self._level(problem, label, before, tight=self._is_tight(label)))

    def _weaker(self, problem: Problem, label: Step) -> Generator[Step, None, Step]:
        """The solution for the largest strength of the monitor that sweeps reach, from the strength of the start."""
        known = replace(label, relaxation=Relaxation(strength=0.0), converged=True, mesh=Mesh.uniform(label.grid))
        if self._solved:
            reached = self._solved[-1].relaxation
            if reached.strength == 1.0:
                reached = Relaxation(strength=1.0 - FIRST_ADVANCE)
            again = yield from self._at(problem, label, reached)
            known = known if again is None else again
        advance = min(FIRST_ADVANCE, 1.0 - known.relaxation.strength)
        while known.relaxation.strength < 1.0 and advance >= MIN_ADVANCE:
            strength = min(1.0, known.relaxation.strength + advance)
            found = yield from self._at(problem, replace(label, mesh=known.mesh), Relaxation(strength=strength))
            advance = advance / 2 if found is None else 1.5 * advance
            known = known if found is None else found
        return replace(known, failed=known.relaxation.strength == 0.0)

    def _at(self, problem: Problem, label: Step, relaxation: Relaxation) -> Steps:
        """Sweeps for a monitor of lower strength from the label's mesh."""
        weak = problem
        if relaxation.strength < 1.0:
            weak = replace(problem, monitor=problem.monitor.weakened(relaxation.strength))
        label = replace(label, relaxation=relaxation)
        return (yield from self._level(weak, label, None, tight=self._is_tight(label)))

    def _level(self, problem: Problem, label: Step, before: Step | None, *, tight: bool) -> Steps:
        shape = padded_shape(label.grid.shape, self._closed)
        coarse = None if before is None else LevelSolution.of(before)
        rows = Rows.whole(shape, self._threads)
        return (yield from ClosedLevel(problem, label, coarse, tight, self._memory, rows).steps())

    def _is_tight(self, label: Step) -> bool:
        """Whether the level is solved to rounding: the last one, where that is requested or no error is known."""
        if label.level + 1 < label.levels:
            return False
        known = bool(self._solved) and is_refined(label.grid, self._solved[-1].grid)
        return self._mode is Mode.TIGHT or not known


def single_domain_steps(
    problem: Problem, start: Mesh | None = None, *, mode: Mode = Mode.TIGHT, sweeps: bool = True, threads: int = 1
) -> Iterator[Step]:
    """Sweeps and Newton steps up the nested grids to the single-domain solution.

    ``start`` is a mesh of the problem's own grid: Newton's method then begins there, without nested iteration.
    ``sweeps=False`` uses Newton's method on all levels: a reference, hundreds of times slower on fine grids. The last
    step has ``converged`` or ``failed`` set; its mesh is valid in any case. Where lines are closed, all of it is by
    sweeps.
    """
    if is_closed(problem.domain):
        yield from ClosedClimb(problem, mode, threads).steps(start)
        return
    if start is not None or not sweeps:
        grids = [problem.grid] if start is not None else nested_grids(problem.grid)
        yield from Climb(problem, mode, threads, grids).by_newton(start)
        return
    grids, square = nested_grids(problem.grid), square_grids(problem.grid)
    solved = yield from Climb(problem, mode, threads, grids).by_sweeps(only_requested=square != grids)
    if solved is None:
        yield from Climb(problem, mode, threads, square).by_sweeps(only_requested=False)


def steps_from(problem: Problem, start: Mesh, *, mode: Mode = Mode.TIGHT, threads: int = 1) -> Iterator[Step]:
    """Sweeps from a mesh near the solution, such as the mesh of an earlier time step; on closed lines tight ones.

    Where the sweeps do not converge, the steps of :func:`single_domain_steps` without a start follow.
    """
    if is_closed(problem.domain):
        yield from ClosedClimb(problem, Mode.TIGHT, threads).steps_from(start)
        return
    own = Mesh(start.x.copy(), start.y.copy())
    label = Step(level=0, levels=1, grid=problem.grid, step=0, residual=math.nan, mesh=own)
    memory, rows = np.empty(memory_needed(problem.grid.shape)), Rows.whole(problem.grid.shape, threads)
    level = Level(problem, label, None, mode is Mode.TIGHT, memory, rows, start_error=MAX_ERROR_FROM_MESH)
    last = yield from level.steps()
    if last is None:
        yield from single_domain_steps(problem, mode=mode, threads=threads)
    else:
        yield last


def guess_on(grid: Grid, solved: list[Step]) -> Mesh:
    """The last solution on a finer grid, extrapolated from the last two where they solve the same equations."""
    coarser = solved[-2].mesh if is_extrapolated(grid, solved) else None
    return prolong(solved[-1].mesh, grid, coarser)
