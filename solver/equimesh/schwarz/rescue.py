"""Newton steps on the whole grid, where a subdomain has stalled or the merged mesh is folded."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS, newton_steps
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.port import MergedSolutions

# After this many steps in a row another condition takes over, or the iteration ends.
MAX_STEPS_IN_A_ROW = 3
# The residual after that many steps, over the one after the first. Above this factor the steps are no progress.
MIN_PROGRESS = 0.9


@dataclass(frozen=True)
class RescueResult:
    """A mesh, and whether it is the result of a step on the whole grid."""

    mesh: Mesh
    is_stepped: bool


class Rescue:
    """Newton steps on the whole grid where they are needed, and the residuals after the last ones in a row.

    ``residuals`` are infinite where the grid is too large for a factorisation.
    """

    def __init__(self, problem: Problem, holding: Holding) -> None:
        self._problem, self._holding = problem, holding
        self.residuals: list[float] = []
        self.has_stepped = False

    def apply(self, solved: MergedSolutions, before: Mesh) -> RescueResult:
        """The merged mesh, or the one after a guarded Newton step on the whole grid.

        A step starts from the merged mesh, or from the one ``before`` the iteration where the merged mesh is folded.
        """
        is_folded = not self._holding.smallest_jacobian(solved.mesh) > 0.0
        if not (is_folded or solved.has_stalled):
            self.residuals = []
            return RescueResult(solved.mesh, is_stepped=False)
        self.has_stepped = True
        mesh = before if is_folded else solved.mesh
        if self._problem.grid.points > MAX_FACTORISED_POINTS:
            self.residuals.append(math.inf)
            return RescueResult(Mesh(mesh.x.copy(), mesh.y.copy()), is_stepped=True)
        stepped, residual = newton_step(self._problem, self._holding, mesh)
        self.residuals.append(residual)
        return RescueResult(stepped, is_stepped=True)

    @property
    def has_failed(self) -> bool:
        """Whether the limit of steps in a row is reached."""
        return len(self.residuals) >= MAX_STEPS_IN_A_ROW

    @property
    def is_stuck(self) -> bool:
        """Whether the last steps in a row did not reduce the residual."""
        recent = self.residuals[-MAX_STEPS_IN_A_ROW:]
        return len(recent) == MAX_STEPS_IN_A_ROW and not recent[-1] < MIN_PROGRESS * recent[0]


def newton_step(problem: Problem, holding: Holding, mesh: Mesh) -> tuple[Mesh, float]:
    """The mesh after one guarded Newton step on the whole grid, and its residual relative to the mean flux."""

    def step(meshes: Sequence[Mesh], states: Sequence[Mesh]) -> tuple[Mesh, float]:
        del states
        *_, last = newton_steps(problem.equations(), meshes[0], most_steps=1, fast=True)
        return Mesh.of_unit_square(last.mesh.x, last.mesh.y), last.residual

    stepped, residual = holding.on_whole(step, [mesh])
    assert stepped is not None
    return stepped, residual
