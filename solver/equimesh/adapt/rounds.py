"""What a loop does on meshes of one kind: the first mesh, and from what a solver returned to the next one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias, TypeVar

import numpy as np

from equimesh.adapt.averaged import averaged_mesh
from equimesh.adapt.indicated import indicated_mesh
from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import Domain, map_mesh
from equimesh.errors import InputError
from equimesh.fields.recovered import reference_on
from equimesh.least_error.elements import Norm
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array
from equimesh.rounds.block_recovery import moved_lengths
from equimesh.rounds.block_round import BlockKnowledge
from equimesh.rounds.next_mesh import KEPT
from equimesh.rounds.recovery import moved_cells
from equimesh.rounds.round import Knowledge
from equimesh_coupling.adaptation import AdaptRound

M = TypeVar("M", Mesh, QuadMesh)
"""The class of the meshes: of a grid, or of blocks."""
Following: TypeAlias = Callable[[], tuple[M, float, str]]
"""The next mesh, how far it moves, and the name of its start."""
Looked: TypeAlias = tuple[AdaptRound[M], Following[M]]
"""The record of what a solver returned, and the way to the next mesh."""

EVEN = "even cells"
"""The name of the descent for averages over the cells of blocks."""


class Rounds(Protocol[M]):
    """The meshes of one kind."""

    def first(self) -> tuple[M, float, str]:
        """The first mesh, as a :data:`Following`."""
        ...

    def copied(self, mesh: M) -> M:
        """The mesh with arrays of its own."""
        ...

    def known(self, mesh: M, values: Array) -> Looked[M]:
        """The record of nodal values, and the way to the next mesh."""
        ...

    def averaged(self, mesh: M, values: Array) -> Looked[M]:
        """As :meth:`known`, of nodal values that were recovered from averages over the cells."""
        ...

    def indicated(self, mesh: M, values: Array) -> Looked[M]:
        """The record of an error indicator, and the way to the next mesh."""
        ...


@dataclass(frozen=True, kw_only=True)
class GridRounds:
    """Meshes of a grid on a ``domain``."""

    grid: Grid
    domain: Domain
    norm: Norm
    threads: int

    def first(self) -> tuple[Mesh, float, str]:
        """The uniform mesh."""
        return map_mesh(Mesh.uniform(self.grid), self.domain), 0.0, "given"

    def copied(self, mesh: Mesh) -> Mesh:
        """The mesh with arrays of its own."""
        return Mesh(mesh.x.copy(), mesh.y.copy())

    def known(self, mesh: Mesh, values: Array) -> Looked[Mesh]:
        """The record of nodal values, and the way to the next mesh."""
        known = Knowledge.of(mesh, values, self.domain, self.threads)

        def following() -> tuple[Mesh, float, str]:
            found = known.next_mesh(self.norm, self.threads)
            return map_mesh(found.reference, self.domain), found.moved_cells, found.chosen

        return record_of(known, mesh, values), following

    averaged = known

    def indicated(self, mesh: Mesh, values: Array) -> Looked[Mesh]:
        """The record of an error indicator, and the way to the next mesh."""

        def following() -> tuple[Mesh, float, str]:
            found = indicated_mesh(mesh, values, self.domain, self.norm, self.threads)
            return found, moved_cells(reference_on(mesh, self.domain), reference_on(found, self.domain)), "weight"

        return AdaptRound(number=0, mesh=mesh, values=values, estimate=float(np.linalg.norm(values))), following


@dataclass(frozen=True, kw_only=True)
class BlockRounds:
    """Meshes of a ``domain`` in blocks."""

    domain: Blocks
    norm: Norm
    threads: int

    def first(self) -> tuple[QuadMesh, float, str]:
        """The initial mesh of the domain."""
        return self.domain.mesh, 0.0, "given"

    def copied(self, mesh: QuadMesh) -> QuadMesh:
        """The mesh with points of its own."""
        return mesh.moved(mesh.points.copy())

    def known(self, mesh: QuadMesh, values: Array) -> Looked[QuadMesh]:
        """The record of nodal values, and the way to the next mesh."""
        known = BlockKnowledge.of(mesh, values, self.domain, self.threads)

        def following() -> tuple[QuadMesh, float, str]:
            found = known.next_mesh(self.norm, self.threads)
            return found.reference, found.moved_cells, found.chosen

        return record_of(known, mesh, values), following

    def averaged(self, mesh: QuadMesh, values: Array) -> Looked[QuadMesh]:
        """The record of recovered values, and the way to a next mesh of even cells."""
        known = BlockKnowledge.of(mesh, values, self.domain, self.threads)

        def following() -> tuple[QuadMesh, float, str]:
            found = mesh if known.is_exact else averaged_mesh(known.recovery.u, self.domain, self.norm, self.threads)
            return found, moved_lengths(mesh, found), KEPT if mesh.distance(found) == 0.0 else EVEN

        return record_of(known, mesh, values), following

    def indicated(self, mesh: QuadMesh, values: Array) -> Looked[QuadMesh]:  # noqa: ARG002
        """Refused: see :data:`NO_INDICATOR`."""
        raise InputError(NO_INDICATOR, field="solve")


NO_INDICATOR = (
    "an error indicator says where cells are wanted, and equal shares of it need the lines of one grid, which blocks do"
    " not have: return values at the nodes, or CellAverages, from which the directions follow, too"
)
"""Why an error indicator is refused on blocks."""


def record_of(known: Knowledge | BlockKnowledge, mesh: M, values: Array) -> AdaptRound[M]:
    """The record of nodal values."""
    return AdaptRound(
        number=0,
        mesh=mesh,
        values=values,
        estimate=0.0 if known.is_exact else known.estimate,
        estimate_h1=known.estimate_h1,
        unresolved=known.unresolved,
    )
