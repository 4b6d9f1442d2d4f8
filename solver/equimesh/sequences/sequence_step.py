"""One step of a sequence: its mesh, the fields on it, and how the nodes have moved."""

from collections.abc import Mapping
from dataclasses import dataclass

from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array
from equimesh.solving.certificate import Certificate
from equimesh.solving.solution import Solution
from equimesh.solving.status import Status


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SequenceStep:
    """The result of :meth:`~equimesh.sequences.sequence.Sequence.step`."""

    number: int
    """1 for the first step."""
    mesh: Mesh
    """The mesh of the sequence after the step: that of the solution, or the last good one where the solve failed.

    The next step begins with it: write into copies of its arrays only.
    """
    solution: Solution
    """The solve of this step, also a failed one."""
    fields: Mapping[str, Array]
    """The fields on the mesh, by their names."""
    velocity: Array | None
    """The displacement of every node in this step, shape ``(n_xi, n_eta, 2)``; ``None`` where the grid has changed.

    Divided by the time step it is the velocity of the mesh.
    """
    moved: float | None
    """The displacement in cells of the mesh before that 95 % of the nodes do not exceed; ``None`` as above."""
    substeps: int
    """The number of meshes that were computed on the way to this one, itself included."""
    notes: tuple[str, ...]
    """Sentences about this step alone: moves, and integrals that bounds did not allow to keep."""

    def __repr__(self) -> str:
        return f"<SequenceStep {self.number}: {self.mesh.grid} points, {self.status}>"

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
