"""The mesh for the next solve, with what is known of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Generic, Self, TypeVar

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.rounds.block_recovery import BlockRecovery
from equimesh.rounds.recovery import Recovery

AnyMesh = TypeVar("AnyMesh", Mesh, QuadMesh)
"""The class of the meshes: those of grids, or of blocks."""
R = TypeVar("R", Recovery, BlockRecovery)
KEPT = "kept"
"""The name of the mesh before, where no candidate is valid or the values are those of a linear function."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AnyKnowledge(Generic[R]):
    """What the values of a solver say of the mesh that they are on."""

    recovery: R
    """u, recovered from the values."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, in the units of u times a length."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. It must not rank meshes: an unresolved one looks good."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""

    @classmethod
    def from_recovery(cls, recovery: R, threads: int) -> Self:
        """With the estimates of a recovered u."""
        slopes, size = recovery.estimate("h1", threads), recovery.gradient_norm()
        return cls(
            recovery=recovery,
            estimate=recovery.estimate("l2", threads),
            estimate_h1=slopes,
            unresolved=slopes / size if size > 0.0 else 0.0,
        )

    @property
    def is_exact(self) -> bool:
        """Whether the estimate is nothing but rounding."""
        return not self.estimate > self.recovery.rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class NextMesh(Generic[AnyMesh]):
    """The mesh for the next solve."""

    reference: AnyMesh
    """The mesh for the next solve on the reference square; of blocks the mesh itself."""
    chosen: str
    """The name of the candidate that it was."""
    candidates: Mapping[str, float]
    """The candidates, with the errors of the interpolant of the recovered u on them in the requested norm."""
    gain: float
    """The error of the interpolant of the recovered u in the requested norm, on the mesh before over that on this one.

    Both are measured at the same points of each cell, which are fewer than those of the estimate. Where the values do
    not resolve the solution it can be below 1.
    """
    moved_cells: float
    """The root mean square of the moves of the nodes, in spacings of the uniform mesh, on blocks in lengths of the mean
    cell.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class Round(Generic[AnyMesh]):
    """The next mesh, and what the values say of the mesh that they are on."""

    mesh: AnyMesh
    """The next mesh of the domain, with as many nodes."""
    reference: AnyMesh
    """The same mesh on the reference square; of blocks the mesh itself."""
    estimate: float
    """The estimated L2 error of the values on their own mesh, 0 where that is nothing but rounding."""
    estimate_h1: float
    """The estimated error of the gradient, in the units of u. It must not rank meshes: an unresolved one looks good."""
    unresolved: float
    """``estimate_h1`` over the norm of the gradient, 0 to about 0.5: the share that the mesh does not resolve."""
    chosen: str
    """As :attr:`NextMesh.chosen`."""
    candidates: Mapping[str, float]
    """As :attr:`NextMesh.candidates`."""
    gain: float
    """As :attr:`NextMesh.gain`."""
    moved_cells: float
    """As :attr:`NextMesh.moved_cells`."""
