"""The records of a loop that adapts a mesh to the solution of a solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from equimesh.inputs import finite_or_none
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class AdaptRound:
    """One solve: its mesh, and what the values say of it. Round 0 is that of the first mesh."""

    number: int
    """0 for the first mesh."""
    mesh: Mesh
    """The mesh that the solver got."""
    values: Array
    """What it returned: values at the nodes, shape ``(n_xi, n_eta)``, or the error indicator of every cell, shape
    ``(n_xi - 1, n_eta - 1)``.
    """
    estimate: float
    """The estimated L2 error of the values, in the units of u times a length; of an indicator the root of the sum of
    its squares.
    """
    estimate_h1: float | None = None
    """The estimated error of the gradient; ``None`` for an indicator. It must not rank meshes."""
    unresolved: float | None = None
    """``estimate_h1`` over the norm of the gradient: the share of the gradient that the mesh does not resolve."""
    moved_cells: float = 0.0
    """The root mean square of the moves of the nodes from the mesh before, in spacings of the uniform mesh."""
    start: str = "given"
    """The candidate that became this mesh, such as ``"lines"``; ``"given"`` for the first mesh."""

    def numbers(self) -> dict[str, Any]:
        """The record without the arrays, as plain Python data, ready for JSON."""
        floats = ("estimate", "estimate_h1", "unresolved", "moved_cells")
        return {
            "number": self.number,
            "start": self.start,
            **{name: finite_or_none(getattr(self, name)) for name in floats},
        }


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Adaptation:
    """The result of :func:`~equimesh.adapt.loop.adapt`: the best mesh, the values on it, and how it was found."""

    rounds: tuple[AdaptRound, ...]
    """All rounds, the first mesh included."""
    best: int
    """The number of the round with the smallest estimate."""
    resolved: bool
    """Whether the best mesh resolves the solution. Where it is ``False``, estimates are too small, and a solution may
    have layers that no mesh of this size has met.
    """
    reason: str
    """Why the loop ended, as a sentence."""
    failure: Exception | None = None
    """What ended the loop where that was the solver, or what it returned; the best mesh before it is kept."""

    @property
    def mesh(self) -> Mesh:
        """The mesh of the best round."""
        return self.rounds[self.best].mesh

    @property
    def values(self) -> Array:
        """What the solver returned on that mesh: see :attr:`AdaptRound.values`."""
        return self.rounds[self.best].values

    @property
    def estimate(self) -> float:
        """The estimated error of the best round."""
        return self.rounds[self.best].estimate

    def __repr__(self) -> str:
        how = "resolved" if self.resolved else "not resolved"
        return f"<Adaptation: {self.mesh.grid} points, round {self.best} of {len(self.rounds) - 1}, {how}>"
