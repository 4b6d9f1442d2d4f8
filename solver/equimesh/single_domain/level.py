"""One level of the nested iteration: sweeps on one grid, guarded against folds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_residual
from equimesh.meshes.folding import smallest_jacobian
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.nested import distance, is_refined, refinement
from equimesh.numerics.types import Array
from equimesh.single_domain.steps import SHARE, TIGHT, Step, Steps
from equimesh.sweeps.sweep import Sweep

# Algebraic error left on a coarsest level that only serves as a start, in units of its spacing.
COARSE_SHARE = 0.01


MOST_SWEEPS, MOST_COLD_SWEEPS = 100, 40


# A sweep that does not lower the moves by this factor, so many times, is too slow: half sweeps are tried, then others.
SLOWEST, MOST_SLOW = 0.9, 3


# The first sweeps from a coarser solution shrink the moves faster than those after them, which shrink them by this.
USUAL_CONTRACTION = 0.25


# No sweep may fold the mesh, nor from the uniform mesh shrink the smallest Jacobian by more than this factor; it is
# halved for that, down to a share of SMALLEST_SHARE.
SHRINKING, SMALLEST_SHARE = 0.2, 1 / 64


@dataclass
class Level:
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
        sweep = Sweep(metric, self.problem.boundary, shape, self.memory, self.threads)
        own = x, y = self.label.mesh.x, self.label.mesh.y
        damping, slow, moves = 1.0, 0, [math.inf]
        tolerance, smallest = max(TIGHT, smallest_residual(metric, shape)), smallest_jacobian(x, y)
        for count in range(1, (MOST_COLD_SWEEPS if self.coarse is None else MOST_SWEEPS) + 1):
            found = sweep.correct(x, y)
            taken, smallest = _guarded(sweep, x, y, damping, SHRINKING * smallest if self.coarse is None else 0.0)
            if not (math.isfinite(found.deviation) and smallest > 0.0):
                return None
            x, y = sweep.swap(x, y)
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


def _guarded(sweep: Sweep, x: Array, y: Array, damping: float, floor: float) -> tuple[float, float]:
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
