"""The rows of a mesh that one process holds: its own, and those next to them."""

from __future__ import annotations

from dataclasses import dataclass

from equimesh.meshes.grid import Grid
from equimesh.numerics.types import Array


@dataclass(frozen=True, eq=False)
class HeldMesh:
    """The rows ``begin`` to ``end - 1`` of a mesh on ``grid``: ``x`` and ``y`` of shape ``(end - begin, n_eta)``."""

    grid: Grid
    begin: int
    x: Array
    y: Array

    @property
    def end(self) -> int:
        """The row after the last one that is held."""
        return self.begin + len(self.x)

    @property
    def is_whole(self) -> bool:
        """Whether these are all rows of the grid."""
        return len(self.x) == self.grid.n_xi
