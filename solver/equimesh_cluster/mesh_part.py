"""Consecutive rows of a mesh: what one of several processes holds of it, and what it needs to measure its cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.parts import quads_of


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshPart:
    """Part ``number`` of ``count`` parts of a mesh on ``grid``: the node rows ``first`` to ``last - 1``.

    ``x`` and ``y`` also hold the first row of the next part, where there is one: the cells that begin in the rows of a
    part need it. Their shape is ``(min(last + 1, n_xi) - first, n_eta)``. Every row belongs to one part, and every
    cell to the part in whose rows it begins.
    """

    grid: Grid
    number: int
    count: int
    first: int
    last: int
    x: Array
    y: Array

    def __post_init__(self) -> None:
        shape = (min(self.last + 1, self.grid.n_xi) - self.first, self.grid.n_eta)
        if not 0 <= self.first < self.last <= self.grid.n_xi:
            raise InputError(f"rows {self.first} to {self.last - 1} are not rows of a grid of {self.grid} points")
        if self.x.shape != shape or self.y.shape != shape:
            raise InputError(f"x and y of this part need the shape {shape}, not {self.x.shape} and {self.y.shape}")

    @property
    def is_last(self) -> bool:
        """Whether no part follows."""
        return self.last == self.grid.n_xi

    @property
    def own_rows(self) -> slice:
        """The rows of ``x`` and ``y`` that belong to this part, without the first one of the next part."""
        return slice(0, self.last - self.first)

    @property
    def cell_rows(self) -> tuple[int, int]:
        """The first cell row of the part, and the one after its last, as numbers of the grid."""
        return self.first, self.first + self.x.shape[0] - 1

    @property
    def cells(self) -> IntArray:
        """Nodes of every cell of the part, counter-clockwise, shape ``(k, 4)``, as numbers in ``x.ravel()``."""
        return quads_of((self.x.shape[0], self.x.shape[1]))

    @property
    def first_node(self) -> int:
        """The number in the whole mesh of the first node of the part; ``cells`` plus it are numbers of the mesh."""
        return self.first * self.grid.n_eta


def cut(mesh: Mesh, cuts: Sequence[int]) -> list[MeshPart]:
    """The parts of a whole mesh that begin at row 0 and at the rows ``cuts``.

    Their arrays are views of the arrays of the mesh, not copies. Raises :class:`~equimesh.errors.InputError` where the
    rows do not grow, or are outside the grid.
    """
    firsts, grid = [0, *cuts, mesh.grid.n_xi], mesh.grid
    return [
        MeshPart(
            grid=grid,
            number=number,
            count=len(firsts) - 1,
            first=first,
            last=last,
            x=mesh.x[first : last + 1],
            y=mesh.y[first : last + 1],
        )
        for number, (first, last) in enumerate(pairwise(firsts))
    ]
