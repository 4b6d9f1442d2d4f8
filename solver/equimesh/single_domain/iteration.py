"""The single-domain mesh, in nested iteration from the uniform mesh on a coarse grid up.

Every level is solved by the chord iteration, the coarsest from the uniform mesh, finer ones from the coarser solution.
Where the coarsest does not converge from there, half the monitor leads up to it; where that does not either, Newton's
method and continuation take over.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.equations.newton_solve import newton_steps, rounding
from equimesh.equations.problem import Problem
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import distance, is_refined, nested_grids, prolong, refinement
from equimesh.single_domain import continuation
from equimesh.single_domain.continuation import NONE, Relaxation
from equimesh.sweeps import sweep as chord

Array: TypeAlias = npt.NDArray[np.float64]

# Relative deviation from equal metric lengths in tight mode, and the algebraic error that is left otherwise, as a
# share of the discretisation error.
TIGHT, SHARE = 1e-10, 0.2
# Algebraic error left on a coarsest level that only serves as a start, in units of its spacing.
COARSE_SHARE = 0.01
# Share of the monitor that leads up to one from whose uniform mesh the sweeps do not converge.
LEADING = 0.5
MOST_SWEEPS, MOST_COLD_SWEEPS = 100, 40
# A sweep that does not lower the moves by this factor, so many times, is too slow: half sweeps are tried, then others.
SLOWEST, MOST_SLOW = 0.9, 3
# The first sweeps from a coarser solution shrink the moves faster than those after them, which shrink them by this.
USUAL_CONTRACTION = 0.25
# No sweep may fold the mesh, nor from the uniform mesh shrink the smallest Jacobian by more than this factor; it is
# halved for that, down to a share of SMALLEST_SHARE.
SHRINKING, SMALLEST_SHARE = 0.2, 1 / 64
# Relaxed equations are solved by sparse factorisations, on grids of up to so many points.
MOST_FACTORISED = 257 * 257
# A mesh with this relative deviation satisfies the asked equations, whichever were solved.
EXACT = 1e-8


class Mode(StrEnum):
    """When a solve is done.

    ``DISCRETIZATION``: when what iterating on would change is a fifth of the error that the grid makes anyway.
    ``TIGHT``: when squared metric lengths differ from the mean of their line by 1e-10 of it; for studies, and for
    references to compare with.
    """

    DISCRETIZATION = "discretization"
    TIGHT = "tight"


@dataclass(frozen=True, kw_only=True)
class Step:
    """One sweep or Newton step of a single-domain solve.

    ``level`` of ``levels`` is the grid of the nested iteration (0 the coarsest). ``relaxation`` is what the equations
    that the step solves differ by from the asked ones. ``residual`` is relative: of a sweep, the largest deviation of a
    squared metric length from the mean of its line; of a Newton step, the largest defect over the mean flux.
    ``mesh``, of the reference square, is overwritten by the next sweep: copy it to keep it.

    ``converged`` is set by the last step of every level, and says that the mesh solves the equations of ``relaxation``
    there; ``failed`` where no mesh was found that solves any. ``algebraic_error`` and ``discretization_error`` are
    estimates in units of the reference square, NaN where not known. ``solved`` is the grid on which the equations were
    solved, coarser than ``grid`` where relaxed ones would have been too costly on that; ``contraction`` the factor by
    which sweeps shrank their moves, 1 where it is not known.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    mesh: Mesh
    relaxation: Relaxation = NONE
    converged: bool = False
    failed: bool = False
    algebraic_error: float = math.nan
    discretization_error: float = math.nan
    solved: Grid | None = None
    contraction: float = 1.0

    @property
    def is_exact(self) -> bool:
        """Whether the mesh solves the asked equations on its own grid."""
        return self.converged and self.relaxation.is_none and self.solved is None

    @property
    def strength(self) -> float:
        """The strength of the monitor, 1 for the asked one."""
        return self.relaxation.strength


Steps: TypeAlias = Generator[Step, None, Step | None]


def iterate(
    problem: Problem, start: Mesh | None = None, *, mode: Mode = Mode.TIGHT, sweeps: bool = True, threads: int = 1
) -> Iterator[Step]:
    """Sweeps and Newton steps up the nested grids to the single-domain solution.

    ``start`` is a mesh of the problem's own grid: Newton's method then begins there, without nested iteration.
    ``sweeps=False`` uses Newton's method on all levels: a reference, hundreds of times slower on fine grids. The last
    step has ``converged`` or ``failed`` set; its mesh is valid in any case.
    """
    grids = [problem.grid] if start is not None else nested_grids(problem.grid)
    memory = np.empty(chord.needed(problem.grid.shape)) if sweeps and start is None else np.empty(0)
    solved: list[Step] = []
    for level, grid in enumerate(grids):
        here = replace(problem, grid=grid)
        guess = start or (guess_on(grid, solved) if solved else Mesh.uniform(grid))
        label = Step(level=level, levels=len(grids), grid=grid, step=0, residual=math.nan, mesh=guess)
        before = solved[-1] if solved else None
        last: Step | None = None
        if sweeps and start is None and (before is None or before.relaxation.is_none):
            known = before is not None and is_refined(grid, before.grid)  # the error of the discretisation can be told
            tight = level + 1 == len(grids) and (mode is Mode.TIGHT or not known)
            last = yield from _Level(here, label, before, tight, memory, threads).steps()
            if last is None and before is None:
                rough = yield from _weaker(here, replace(label, mesh=Mesh.uniform(grid)), memory, threads)
                if rough is not None:
                    label = replace(label, mesh=rough.mesh)
                    last = yield from _Level(here, label, None, tight, memory, threads).steps()
        if last is None:
            plain = not sweeps or start is not None
            if start is None and solved:
                label = replace(label, mesh=guess_on(grid, solved))  # sweeps have worked in the memory of the first
            elif start is None:
                label = replace(label, mesh=Mesh.uniform(grid))
            last = yield from _factorised(here, label, before, plain=plain)
        yield last
        if last.failed:
            return
        solved = [*solved[-1:], last]


def _weaker(problem: Problem, label: Step, memory: Array, threads: int) -> Steps:
    """Sweeps from the uniform mesh for half the monitor; ``None`` where they do not converge, either.

    From the uniform mesh a sweep for a steep front overshoots; from the mesh of half the front it seldom does.
    """
    weak = replace(problem, monitor=problem.monitor.weakened(LEADING))
    label = replace(label, relaxation=continuation.Relaxation(strength=LEADING))
    return (yield from _Level(weak, label, None, False, memory, threads).steps())


def iterate_from(problem: Problem, start: Mesh, *, threads: int = 1) -> Iterator[Step]:
    """Sweeps from a mesh near the solution, as that of a monitor a time step earlier, to a tight tolerance.

    Where they do not converge, what :func:`iterate` does without a start.
    """
    own = Mesh(start.x.copy(), start.y.copy())
    label = Step(level=0, levels=1, grid=problem.grid, step=0, residual=math.nan, mesh=own)
    memory = np.empty(chord.needed(problem.grid.shape))
    last = yield from _Level(problem, label, None, True, memory, threads).steps()
    if last is None:
        yield from iterate(problem, mode=Mode.TIGHT, threads=threads)
    else:
        yield last


def guess_on(grid: Grid, solved: list[Step]) -> Mesh:
    """The last solution on a finer grid, extrapolated from the last two where they solve the same equations."""
    last = solved[-1]
    same = len(solved) > 1 and solved[-2].relaxation == last.relaxation
    return prolong(last.mesh, grid, solved[-2].mesh if same else None)


@dataclass
class _Level:
    """The chord iteration on one level: full sweeps near the solution, guarded ones from the uniform mesh."""

    problem: Problem
    label: Step
    coarse: Step | None
    tight: bool
    memory: Array
    threads: int

    def steps(self) -> Steps:
        """Sweeps; returns the last step, or ``None`` where the iteration does not converge to a valid mesh."""
        metric, shape = self.problem.metric, self.problem.grid.shape
        sweep = chord.Sweep(metric, self.problem.boundary, shape, self.memory, self.threads)
        own = x, y = self.label.mesh.x, self.label.mesh.y
        damping, slow, moves = 1.0, 0, [math.inf]
        tolerance, smallest = max(TIGHT, rounding(metric, shape)), smallest_jacobian(x, y)
        for count in range(1, (MOST_COLD_SWEEPS if self.coarse is None else MOST_SWEEPS) + 1):
            found = sweep.correct(x, y)
            taken, smallest = _guarded(sweep, x, y, damping, SHRINKING * smallest if self.coarse is None else 0.0)
            if not (math.isfinite(found.deviation) and smallest > 0.0):
                return None
            x, y = sweep.take(x, y)
            moves.append(found.move)
            contraction = self._contraction(moves)
            left = _left(found.move, contraction) if taken == 1.0 else math.inf
            step = replace(
                self.label,
                step=count,
                residual=found.deviation,
                mesh=Mesh(x, y),
                algebraic_error=left,
                contraction=contraction,
            )
            done = found.deviation <= tolerance if self.tight else self._is_near(step)
            if done:
                return self._finished(step, own)
            yield step
            slow = slow + 1 if not moves[-1] < SLOWEST * min(moves[:-1]) else 0
            if slow > MOST_SLOW and self.coarse is not None:
                if damping < 1.0:
                    return None
                damping, slow, moves = 0.5, 0, [math.inf]
        return None

    def _contraction(self, moves: list[float]) -> float:
        """What the next sweeps shrink the moves by: as the last two moves did, or those on the coarser level."""
        if math.isfinite(moves[-2]) and moves[-2] > 0.0:
            return max(USUAL_CONTRACTION, moves[-1] / moves[-2])
        return 1.0 if self.coarse is None else self.coarse.contraction

    def _is_near(self, step: Step) -> bool:
        """Whether the algebraic error is small beside that of the discretisation, or serves for a first level."""
        if self.coarse is None or not is_refined(self.problem.grid, self.coarse.grid):
            return step.algebraic_error <= COARSE_SHARE * min(self.problem.grid.d_xi, self.problem.grid.d_eta)
        return math.isfinite(step.algebraic_error) and step.algebraic_error <= SHARE * self._discretization(step.mesh)

    def _discretization(self, mesh: Mesh) -> float:
        """The error that an error of second order leaves on this grid, from the difference to the coarser one."""
        if self.coarse is None or not is_refined(mesh.grid, self.coarse.grid):
            return math.nan
        return distance(mesh, self.coarse.mesh) / (refinement(mesh.grid, self.coarse.grid) - 1.0)

    def _finished(self, step: Step, own: tuple[Array, Array]) -> Step:
        """The step with its mesh outside the working memory."""
        mesh = step.mesh
        if mesh.x is not own[0]:
            own[0][:], own[1][:] = mesh.x, mesh.y
            mesh = Mesh(*own)
        return replace(step, mesh=mesh, converged=True, discretization_error=self._discretization(mesh))


def _guarded(sweep: chord.Sweep, x: Array, y: Array, damping: float, floor: float) -> tuple[float, float]:
    """Shrink the moves of a sweep, by ``damping`` and then by halves until the smallest Jacobian is above ``floor``.

    Returns the share of the moves that is left, and the smallest Jacobian: not positive where halving did not help.
    """
    share = 1.0
    while True:
        if damping < 1.0:
            for moved, old in ((sweep.new_x, x), (sweep.new_y, y)):
                moved -= old
                moved *= damping
                moved += old
            share *= damping
        smallest = smallest_jacobian(sweep.new_x, sweep.new_y)
        if smallest > floor:
            return share, smallest
        if share < SMALLEST_SHARE:
            return share, 0.0
        damping = 0.5


def _left(move: float, contraction: float) -> float:
    """The distance still to go after a move, if those to come shrink by ``contraction`` each."""
    return move * contraction / (1.0 - contraction) if contraction < 1.0 else math.inf if move > 0.0 else 0.0


def _factorised(problem: Problem, label: Step, before: Step | None, *, plain: bool) -> Generator[Step, None, Step]:
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
    if before is None or problem.grid.points <= MOST_FACTORISED:
        found = yield from _labelled(continuation.attempts(problem, label.mesh, relaxation), label)
    if found is None and before is not None:
        solved = before.solved or before.grid
        return replace(label, relaxation=relaxation, residual=math.nan, converged=True, solved=solved)
    if found is None:
        raise AssertionError("on the first level there is always something left to try")
    step = replace(label, step=found.steps, residual=found.residual, mesh=found.mesh, relaxation=found.relaxation)
    if not step.relaxation.is_none and chord.deviation(problem.metric, problem.boundary, found.mesh) < EXACT:
        step = replace(step, relaxation=NONE)  # a term that vanishes on a mesh of straight lines has relaxed nothing
    return _with_errors(replace(step, converged=found.converged, failed=not found.converged), before)


def _labelled(attempts: continuation.Attempts, label: Step) -> Generator[Step, None, continuation.Attempt | None]:
    while True:
        try:
            found = next(attempts)
        except StopIteration as end:
            result: continuation.Attempt | None = end.value
            return result
        yield replace(label, step=found.steps, residual=found.residual, mesh=found.mesh, relaxation=found.relaxation)


def _with_errors(step: Step, before: Step | None) -> Step:
    """The step with error estimates, for a mesh that Newton's method has solved to rounding."""
    if not step.converged:
        return step
    if before is None or before.relaxation != step.relaxation or not is_refined(step.grid, before.grid):
        return replace(step, algebraic_error=0.0)
    error = distance(step.mesh, before.mesh) / (refinement(step.grid, before.grid) - 1.0)
    return replace(step, algebraic_error=0.0, discretization_error=error)
