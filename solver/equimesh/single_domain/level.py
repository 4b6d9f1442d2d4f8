"""One level of the nested iteration: sweeps on one grid, guarded against folds."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Self, TypeAlias

import numpy as np

from equimesh.equations.newton_solve import newton_steps, smallest_residual
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Grid, Mesh, MeshRows, smallest_jacobian
from equimesh.meshes.nested import distance, distance_in_rows, is_refined, refinement
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array
from equimesh.single_domain import continuation
from equimesh.single_domain.continuation import NONE, Relaxation
from equimesh.sweeps.deviation import deviation
from equimesh.sweeps.kernels import Nodes
from equimesh.sweeps.one_strip import is_one_strip, sweeps_of
from equimesh.sweeps.sweep import WHOLE, Frame, Sweep
from equimesh.sweeps.verdict import (
    DONE,
    GO_ON,
    HALVE,
    MIN_JACOBIAN_SHARE,
    MIN_MOVE_SHARE,
    RESIDUAL,
    SMALLEST,
    Rules,
    Swept,
    judge,
    nothing_known,
)

# The records of the steps of a single-domain solve, and its modes.

# Relative deviation of squared metric lengths from the mean of their line, in tight mode.
TIGHT_DEVIATION = 1e-10


class Mode(StrEnum):
    """The condition that ends a single-domain solve.

    ``DISCRETIZATION``: when further iterations would change the mesh by no more than a fifth of the error of the grid,
    from a given mesh by no more than 0.001 of a cell; on closed lines a given mesh is solved as with ``TIGHT``.
    ``TIGHT``: when squared metric lengths differ from the mean of their line by at most 1e-10 of it; for studies and
    references.
    """

    DISCRETIZATION = "discretization"
    TIGHT = "tight"


@dataclass(frozen=True, kw_only=True)
class Step:
    """The record of one sweep or Newton step of a single-domain solve. Lengths are in units of the reference square."""

    level: int
    """The number of the nested grid, 0 for the coarsest."""
    levels: int
    """The number of nested grids."""
    grid: Grid
    """The grid of the level."""
    step: int
    """The number of the step on its level."""
    residual: float
    """A relative residual before a sweep or after a Newton step.

    For a sweep it is the largest deviation of a squared metric length from the mean of its line. For a Newton step it
    is the largest defect over the mean flux.
    """
    mesh: Mesh
    """The mesh of the reference square."""
    relaxation: Relaxation = NONE
    """The difference between the requested equations and those that the step solves."""
    converged: bool = False
    """Whether this is the last step of its level, and the mesh solves the equations of ``relaxation``."""
    failed: bool = False
    """Whether the solve ended without a mesh that solves any of the equations tried."""
    algebraic_error: float = math.nan
    """Estimated error from stopping the iteration, NaN where not known."""
    discretization_error: float = math.nan
    """Estimated error of the grid, NaN where not known."""
    solved: Grid | None = None
    """The coarser grid on which the equations were solved, where ``grid`` was too fine for relaxed ones."""
    contraction: float = 1.0
    """The factor by which sweeps reduce their moves, 1 where not known."""
    fraction: float | None = None
    """For observers: the share of the work of the whole solve that is done, 0 to 1; ``None`` where it is not known."""
    phase: str = ""
    """For observers: what is being done, in words."""

    def snapshot(self) -> Self:
        """The step with its own copy of the mesh, which later sweeps of the level would overwrite."""
        if self.converged or self.failed:
            return self
        return replace(self, mesh=Mesh(self.mesh.x.copy(), self.mesh.y.copy()))

    @property
    def is_exact(self) -> bool:
        """Whether the mesh solves the requested equations on its own grid."""
        return self.converged and self.relaxation.is_none and self.solved is None

    @property
    def strength(self) -> float:
        """The strength of the monitor, 1 for the requested one."""
        return self.relaxation.strength


Steps: TypeAlias = Generator[Step, None, Step | None]


# Algebraic error on a coarsest level that only serves as a start, in units of its spacing.
MAX_START_ERROR = 0.01
# The same where a given mesh is the start of the level that ends the solve. Nested iteration leaves more.
MAX_ERROR_FROM_MESH = 1e-3
# Sweeps of one level, from a coarser solution and from the uniform mesh.
MAX_SWEEPS = 100
MAX_COLD_SWEEPS = 40


@dataclass(frozen=True)
class LevelSolution:
    """The solution on a level: the last step, and the rows of its mesh that are here."""

    step: Step
    mesh: MeshRows

    @classmethod
    def of(cls, step: Step, rows: Rows | None = None) -> LevelSolution:
        """The level of a step whose mesh has these ``rows``, all rows by default."""
        x, y = np.ascontiguousarray(step.mesh.x), np.ascontiguousarray(step.mesh.y)
        return cls(step, MeshRows(x, y, rows or Rows.whole(step.grid.shape)))

    @property
    def grid(self) -> Grid:
        """The grid of the level."""
        return self.step.grid


@dataclass
class Level:
    """The chord iteration on one level: full sweeps near the solution, guarded ones from the uniform mesh.

    The meshes of its steps have the ``rows`` that are here.
    """

    problem: Problem
    label: Step
    coarse: LevelSolution | None
    tight: bool
    memory: Array
    rows: Rows
    start_error: float = MAX_START_ERROR
    """The algebraic error, in units of the spacing, where no coarser solution tells that of the grid."""

    def steps(self) -> Steps:
        """Sweeps; returns the last step, or ``None`` where the iteration does not converge to a valid mesh."""
        own, known = self._start(), nothing_known(0.0)
        if self.coarse is None:
            known[SMALLEST] = smallest_jacobian(*own)
        for count, swept in enumerate(self._sweeps(own, known), 1):
            residual, left, contraction, error = swept.record
            label = self.label
            step = Step(
                level=label.level,
                levels=label.levels,
                grid=label.grid,
                step=count,
                residual=residual,
                mesh=self._mesh(swept.x, swept.y),
                relaxation=label.relaxation,
                algebraic_error=left,
                contraction=contraction,
            )
            if swept.verdict == DONE:
                if self.tight:
                    error = self.rows.agreed(self._gap(swept.x, swept.y))[0] / self._rules.per_gap
                return self._finished(step, own, error)
            yield step
        return None

    def _sweeps(self, own: tuple[Array, Array], known: Array) -> Iterator[Swept]:
        """The sweeps from the nodes ``own``, until the level is solved, or lost."""
        x, y = own
        problem, rules, most = self.problem, self._rules, self._most_sweeps
        in_order = x.flags.c_contiguous and y.flags.c_contiguous
        if in_order and self._frame is WHOLE and is_one_strip(problem, self.rows):
            coarse = None if self.coarse is None else self.coarse.mesh
            yield from sweeps_of(problem, Nodes(x, y), self.memory, coarse, rules, known, most)
            return
        sweep = self._sweep()
        record = np.empty(4)
        for _ in range(most):
            taken = sweep.guard(
                x,
                y,
                sweep.correct(x, y),
                halve=known[HALVE] > 0.0,
                floor=0.0 if rules.has_coarse else MIN_JACOBIAN_SHARE * known[SMALLEST],
                min_share=MIN_MOVE_SHARE,
                measure=None if self.tight else self._gap,
            )
            if not (math.isfinite(taken.deviation) and taken.smallest > 0.0):
                return
            x, y = sweep.swap(x, y)
            known[SMALLEST], record[RESIDUAL] = taken.smallest, taken.deviation
            verdict = judge(rules, known, taken.move, taken.share, taken.gap, record)
            yield Swept(verdict, record.tolist(), x, y)
            if verdict != GO_ON:
                return

    def _sweep(self) -> Sweep:
        """The sweeps, where they are made one by one."""
        return Sweep(self.problem.metric, self.problem.boundary, self.rows, self.memory, self._frame)

    @cached_property
    def _rules(self) -> Rules:
        """The rules by which the sweeps of the level end."""
        grid, coarse = self.problem.grid, self.coarse
        return Rules(
            tight=self.tight,
            known=coarse is not None and is_refined(grid, coarse.grid),
            has_coarse=coarse is not None,
            tolerance=max(self._tight_deviation, smallest_residual(self.problem.metric, grid.shape)),
            start_error=self.start_error * min(grid.d_xi, grid.d_eta),
            contraction=1.0 if coarse is None else coarse.step.contraction,
            per_gap=1.0 if coarse is None else refinement(grid, coarse.grid) - 1.0,
        )

    @property
    def _frame(self) -> Frame:
        """The kind of the four sides of the grid."""
        return WHOLE

    @property
    def _most_sweeps(self) -> int:
        """The number of sweeps after which the level is given up."""
        return MAX_COLD_SWEEPS if self.coarse is None else MAX_SWEEPS

    @property
    def _tight_deviation(self) -> float:
        """The relative deviation of squared metric lengths at which a tight level ends."""
        return TIGHT_DEVIATION

    def _start(self) -> tuple[Array, Array]:
        """The nodes with which the level begins, in the memory in which it may also end."""
        return self.label.mesh.x, self.label.mesh.y

    def _mesh(self, x: Array, y: Array) -> Mesh:
        """The mesh of the nodes of a sweep."""
        return Mesh(x, y)

    def _gap(self, x: Array, y: Array) -> float:
        """The difference of the own rows to the coarser solution; NaN where no error can be estimated from it."""
        if self.coarse is None or not is_refined(self.problem.grid, self.coarse.grid):
            return math.nan
        return distance_in_rows(MeshRows(x, y, self.rows), self.coarse.mesh)

    def _finished(self, step: Step, own: tuple[Array, Array], error: float) -> Step:
        """The last step, with its mesh outside the working memory."""
        mesh = step.mesh
        if mesh.x is not own[0]:
            moved = mesh.x, mesh.y
            self.rows.each(lambda share: copy_rows(own, moved, share.rows))
            for around in (slice(0, self.rows.own_nodes.start), slice(self.rows.own_nodes.stop, None)):
                copy_rows(own, moved, around)
            mesh = Mesh(*own)
        return replace(step, mesh=mesh, converged=True, discretization_error=error)


def copy_rows(into: tuple[Array, Array], values: tuple[Array, Array], rows: slice) -> None:
    """Copy some rows of the nodes of a mesh."""
    for target, source in zip(into, values, strict=True):
        target[rows] = source[rows]


# Newton's method and continuation on one level, where sweeps find no solution.

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
    """The end of a level that keeps its start, the interpolated mesh of the coarser level ``before``."""
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
