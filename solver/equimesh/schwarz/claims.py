"""The check of convergence after a slow iteration: a Newton step on the whole grid has to confirm it."""

from dataclasses import dataclass

from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.rescue import newton_step


@dataclass(frozen=True)
class Claim:
    """The mesh of an iteration, and the estimate of its error.

    ``change`` is the largest move of a coordinate from the mesh ``before`` the iteration. ``is_refuted`` is set where
    the check moved the mesh by more than the tolerance. All lengths are in units of the reference square.
    """

    mesh: Mesh
    estimate: float
    change: float
    before: Mesh
    is_refuted: bool = False


def examine(problem: Problem, holding: Holding, claim: Claim, enough: float) -> Claim:
    """The claim after a Newton step on the whole grid.

    Where the step moves the mesh by more than ``enough``, the iteration continues from the mesh of the step.
    """
    stepped, _ = newton_step(problem, holding, claim.mesh)
    moved = holding.distance(stepped, claim.mesh)
    estimate = max(claim.estimate, moved)
    if not moved > enough:
        return Claim(claim.mesh, estimate, claim.change, claim.before)
    return Claim(stepped, estimate, holding.distance(stepped, claim.before), claim.before, is_refuted=True)
