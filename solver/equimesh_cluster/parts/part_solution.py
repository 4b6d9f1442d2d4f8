"""The share of one part in a solution in parts."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.meshes.held_mesh import HeldMesh
from equimesh.meshes.mesh_part import MeshPart
from equimesh.numerics.channel import Traffic
from equimesh.single_domain.steps import Mode
from equimesh.solving.status import Status
from equimesh_schema import Relaxed


@dataclass(frozen=True, kw_only=True)
class PartStep:
    """The record of one sweep, or of the end of a level; as :class:`~equimesh.single_domain.steps.Step`, no mesh.

    The numbers are those of the whole mesh; every part has the same ones. The traffic is that of this part.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    algebraic_error: float
    discretization_error: float
    contraction: float
    converged: bool
    traffic: dict[str, Traffic]
    """The traffic of this part since the last record, by the kind of the message."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PartSolution:
    """The rows of one part of a solution, and the record of its computation.

    Everything but the meshes and the traffic is that of the whole solution, and the same in every part: these have the
    names and the meaning that they have in :class:`~equimesh.solving.solution.Solution`.
    """

    problem: Problem
    mode: Mode
    status: Status
    mesh: MeshPart
    """The rows of the mesh of the domain: those of this part, and the first one of the next part."""
    reference: HeldMesh
    """The same mesh on the reference square: the rows of this part, and one more each way."""
    newton_steps: int
    residual: float
    note: str = ""
    remedy: str = ""
    relaxed: tuple[Relaxed, ...] = ()
    algebraic_error: float | None = None
    discretization_error: float | None = None
    threads: int = 1
    records: tuple[PartStep, ...] = ()
    """One record for each sweep on the levels that were solved in parts."""
