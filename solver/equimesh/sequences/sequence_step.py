"""One step of a sequence: its mesh, the fields on it, and how the nodes have moved."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

import numpy as np

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.solving.block_solution import BlockSolution
from equimesh.solving.certificate import Certificate
from equimesh.solving.solution import Solution
from equimesh.solving.status import Status
from equimesh.transfers.mesh_values import MeshValues

M = TypeVar("M", Mesh, QuadMesh)
S = TypeVar("S", Solution, BlockSolution)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AnyStep(Generic[M, S]):
    """The members that steps on grids and on blocks share."""

    number: int
    """1 for the first step."""
    mesh: M
    """The mesh of the sequence after the step: that of the solution, or the last good one where the solve failed.

    The next step begins with it: write into copies of its arrays only.
    """
    solution: S
    """The solve of this step, also a failed one."""
    fields: Mapping[str, Array]
    """The fields on the mesh, by their names."""
    velocity: Array | None
    """The displacement of every node in this step, shape ``(n_xi, n_eta, 2)``, on blocks ``(n, 2)``; ``None`` where the
    grid has changed.

    Divided by the time step it is the velocity of the mesh.
    """
    moved: float | None
    """The displacement in cells of the mesh before that 95 % of the nodes do not exceed; ``None`` as above."""
    substeps: int
    """The number of meshes that were computed on the way to this one, itself included."""
    notes: tuple[str, ...]
    """Sentences about this step alone: moves, and integrals that bounds did not allow to keep."""

    @classmethod
    def kept(cls, number: int, mesh: M, solution: S, given: Mapping[str, MeshValues]) -> Self:
        """The step of a solve that failed: it keeps the mesh and the fields as they were."""
        return cls(
            number=number,
            mesh=mesh,
            solution=solution,
            fields={name: field.on(mesh, name) for name, field in given.items()},
            velocity=np.zeros((*mesh.node_shape, 2)),
            moved=0.0,
            substeps=1,
            notes=("The solve failed: the mesh before and its fields are kept.",),
        )

    @property
    def status(self) -> Status:
        """How the solve ended."""
        return self.solution.status

    @property
    def certificate(self) -> Certificate:
        """How good the mesh of the solve is."""
        return self.solution.certificate

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences to read before going on: those of the step, and those of the certificate."""
        return (*self.notes, *self.certificate.warnings)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SequenceStep(AnyStep[Mesh, Solution]):
    """The result of :meth:`~equimesh.sequences.sequence.Sequence.step`."""

    def __repr__(self) -> str:
        return f"<SequenceStep {self.number}: {self.mesh.grid} points, {self.status}>"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BlockStep(AnyStep[QuadMesh, BlockSolution]):
    """The result of :meth:`~equimesh.sequences.block_sequence.BlockSequence.step`."""

    def __repr__(self) -> str:
        return f"<BlockStep {self.number}: {len(self.mesh.points)} points, {self.status}>"
