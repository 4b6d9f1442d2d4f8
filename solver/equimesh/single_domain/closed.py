"""Nested iteration where grid lines are closed: sweeps on every level.

The equations of closed lines are solved by sweeps alone. Where these do not converge, the strength of the monitor is
raised from 0 in adaptive steps, as far as they do.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import replace

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.equations.problem import Problem
from equimesh.meshes.closed import (
    Closed,
    closed_mesh,
    distance_closed,
    padded,
    padded_shape,
    prolong_closed,
    unpadded,
)
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import is_refined, nested_grids
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.level import MAX_SWEEPS, Level, Solved
from equimesh.single_domain.steps import Mode, Step, Steps
from equimesh.sweeps.frame import Frame
from equimesh.sweeps.sweep import memory_needed

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
        """The solution for the largest strength of the monitor that sweeps reach, raised from that of the start."""
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
        coarse = None if before is None else Solved.of(before)
        parts = Parts.of(shape, self._threads)
        return (yield from ClosedLevel(problem, label, coarse, tight, self._memory, parts).steps())

    def _is_tight(self, label: Step) -> bool:
        """Whether the level is solved to rounding: the last one, where that is requested or no error is known."""
        if label.level + 1 < label.levels:
            return False
        known = bool(self._solved) and is_refined(label.grid, self._solved[-1].grid)
        return self._mode is Mode.TIGHT or not known
