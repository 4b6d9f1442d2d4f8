"""The levels of a nested iteration, from coarse to fine.

Every level begins with the mesh of the coarser ones, interpolated. Sweeps solve it. Where they do not converge,
Newton's method and continuation take over, on grids that are not too fine for them; a finer grid keeps the interpolated
mesh.
"""

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.held_mesh import HeldMesh
from equimesh.meshes.interpolation import rows_needed
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import is_refined, prolong_rows
from equimesh.meshes.parts import Parts, rows_held
from equimesh.numerics.channel import ALONE, Channel
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.level import Level, Solved
from equimesh.single_domain.newton_level import interpolated_level, newton_level
from equimesh.single_domain.steps import Mode, Step, Steps
from equimesh.sweeps.sweep import memory_needed

# The strength of the monitor that gives a start where the sweeps do not converge from the uniform mesh.
LEADING_STRENGTH = 0.5


class Climb:
    """The levels of one nested iteration, and the last two solutions.

    ``first`` is the number of the first level. Those below it are solved: ``solved`` has the last two of them, with at
    least the rows that this process needs. All processes of ``channel`` climb together; each has its own rows.
    """

    def __init__(
        self,
        problem: Problem,
        mode: Mode,
        threads: int,
        grids: Sequence[Grid],
        *,
        channel: Channel = ALONE,
        first: int = 0,
        solved: Sequence[Solved] = (),
    ) -> None:
        self._problem, self._mode, self._threads, self._grids = problem, mode, threads, grids
        self._channel, self._first, self.solved = channel, first, list(solved)

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

    def by_sweeps(self, *, only_requested: bool, end: int | None = None) -> Steps:
        """Sweeps, and Newton's method where they fail, on the levels below ``end``; returns the last step.

        ``None`` is returned where ``only_requested`` equations may be solved, and some level has no solution of them.
        """
        levels = range(self._first, len(self._grids) if end is None else end)
        memory = np.empty(max((memory_needed(self._parts(level).held_shape) for level in levels), default=0))
        last: Step | None = None
        for level in levels:
            here = self._problem.on_grid(self._grids[level])
            last = yield from self._sweeps(here, self._label(level), memory)
            if last is None and only_requested:
                return None
            if last is None:  # sweeps have overwritten the first guess
                last = yield from self._without_sweeps(here, self._label(level))
            yield last
            if last.failed:
                break
            self._keep(last)
        return last

    def _parts(self, level: int) -> Parts:
        """The rows of a level that this process holds."""
        return Parts.of(self._grids[level].shape, self._threads, self._channel)

    def _keep(self, last: Step) -> None:
        begin = Parts.of(last.grid.shape, 1, self._channel).begin
        self.solved = [*self.solved[-1:], Solved.of(last, begin)]

    @property
    def _before(self) -> Solved | None:
        return self.solved[-1] if self.solved else None

    def _label(self, level: int) -> Step:
        """The record with which a level begins: its mesh is interpolated from the coarser levels."""
        grid = self._grids[level]
        if self.solved:
            guess = self._guess(grid, self._parts(level))
            mesh = Mesh(guess.x, guess.y)
        else:
            mesh = Mesh.uniform(grid)
        return Step(level=level, levels=len(self._grids), grid=grid, step=0, residual=math.nan, mesh=mesh)

    def _guess(self, grid: Grid, parts: Parts) -> HeldMesh:
        """The mesh of the coarser levels on ``grid``, in the rows that this process holds."""
        steps, number = [level.step for level in self.solved], self._channel.number
        wanted = [
            rows_needed(steps[-1].grid.n_xi, grid.n_xi, rows) for rows in rows_held(grid.shape, parts.channel.count)
        ]
        last, coarser = self._with_rows(-1, wanted), None
        if is_extrapolated(grid, steps):
            below = [rows_needed(steps[-2].grid.n_xi, last.grid.n_xi, rows) for rows in wanted]
            coarser = self._with_rows(-2, below)
        return prolong_rows(last.window(*wanted[number]), grid, coarser, parts)

    def _with_rows(self, which: int, wanted: Sequence[tuple[int, int]]) -> HeldMesh:
        """One of the last two solutions with the rows that are wanted, which it keeps."""
        solved = self.solved[which]
        begin, end = wanted[self._channel.number]
        if self._channel.count > 1 and solved.step.level >= self._first:
            mesh = solved.mesh.with_rows(wanted, self._channel)
            self.solved[which] = solved = Solved(replace(solved.step, mesh=Mesh(mesh.x, mesh.y)), mesh)
        if not (solved.mesh.begin <= begin and end <= solved.mesh.end):
            raise AssertionError(f"rows {begin} to {end - 1} are needed, {solved.mesh.ends} are held")
        return solved.mesh

    def _sweeps(self, problem: Problem, label: Step, memory: Array) -> Steps:
        """The sweeps of one level; ``None`` where they do not converge, or the coarser level is relaxed."""
        before, parts = self._before, self._parts(label.level)
        if before is not None and not before.step.relaxation.is_none:
            return None
        known = before is not None and is_refined(problem.grid, before.grid)  # the grid's error can be estimated
        tight = label.level + 1 == label.levels and (self._mode is Mode.TIGHT or not known)
        last = yield from Level(problem, label, before, tight, memory, parts).steps()
        if last is None and before is None:
            label = replace(label, mesh=Mesh.uniform(problem.grid))
            rough = yield from _weaker(problem, label, memory, parts)
            if rough is not None:
                label = replace(label, mesh=rough.mesh)
                last = yield from Level(problem, label, None, tight, memory, parts).steps()
        return last

    def _without_sweeps(self, problem: Problem, label: Step) -> Generator[Step, None, Step]:
        """A level on which sweeps find no solution. Where rows are held by many processes, it is too fine for more."""
        before = None if self._before is None else self._before.step
        if before is not None and self._channel.count > 1:
            return interpolated_level(label, before)
        return (yield from newton_level(problem, label, before, plain=False, rough=label.level + 1 < label.levels))


def is_extrapolated(grid: Grid, solved: Sequence[Step]) -> bool:
    """Whether the mesh on a finer grid is extrapolated from the last two solutions: those of the same equations."""
    return len(solved) > 1 and solved[-2].relaxation == solved[-1].relaxation and is_refined(grid, solved[-1].grid)


def _weaker(problem: Problem, label: Step, memory: Array, parts: Parts) -> Steps:
    """Sweeps from the uniform mesh for half the monitor; ``None`` where these do not converge, either.

    A sweep for a steep front overshoots from the uniform mesh, but seldom from the mesh of half the monitor.
    """
    weak = replace(problem, monitor=problem.monitor.weakened(LEADING_STRENGTH))
    label = replace(label, relaxation=Relaxation(strength=LEADING_STRENGTH))
    return (yield from Level(weak, label, None, False, memory, parts).steps())
