"""Nests: the nested meshes of a domain, and the first meshes on them, for grids and blocks alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

from equimesh.fields.field import Field
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import Chart
from equimesh.least_error.elements import Norm
from equimesh.least_error.levels import AnyLevel
from equimesh.least_error.objective import Objective
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.numerics.types import Array


class Way(Protocol):
    """Where a descent starts on each of the nested meshes; its distortion is relative to these first meshes."""

    @property
    def name(self) -> str:
        """That of the first mesh, for the records."""
        ...

    @property
    def is_uniform(self) -> bool:
        """Whether the first meshes are the initial ones of the domain."""
        ...


AnyMesh = TypeVar("AnyMesh", bound=Mesh | QuadMesh)
AnyWay = TypeVar("AnyWay", bound=Way)


class Nest(Protocol[AnyLevel, AnyMesh, AnyWay]):
    """What a solve has to know of a grid on a domain, or of a domain in blocks.

    Meshes are arrays of the unknowns of the chart of their level, of shape ``(2, nodes)``.
    """

    @property
    def levels(self) -> Sequence[AnyLevel]:
        """The nested meshes, from coarse to fine."""
        ...

    @property
    def is_regular(self) -> bool:
        """Whether lines of nodes run from side to side, and sides are simple: no line ends inside, or at a corner that
        turns inwards, and the sides of blocks are straight. Other domains have larger weights, and more steps."""
        ...

    def chart(self, level: AnyLevel) -> Chart:
        """What the unknowns of a mesh are."""
        ...

    def cells(self, level: AnyLevel, *, are_cut: bool) -> Cells:
        """The cells; ``are_cut`` tells whether triangles of them are used."""
        ...

    def initial(self, level: AnyLevel) -> Array:
        """The uniform mesh of a grid, or the initial mesh of a domain in blocks."""
        ...

    def start(self, way: AnyWay, level: AnyLevel) -> Array:
        """The first mesh of a way."""
        ...

    def uniform(self) -> AnyWay:
        """The way from the initial mesh."""
        ...

    def rectilinear(self, u: Field, norm: Norm, most: int, floor: float) -> AnyWay | None:
        """The way from straight lines, at most ``most`` of each family; ``None`` where there are none.

        See :func:`~equimesh.least_error.starts.equidistributed`.
        """
        ...

    def given(self, mesh: AnyMesh) -> AnyWay:
        """The way from a mesh of the finest level, where no mesh with a lower objective has a larger error."""
        ...

    def from_coarse(self, mesh: AnyMesh) -> AnyWay:
        """The way that continues from such a mesh on a coarse level."""
        ...

    def sampled(self, mesh: AnyMesh, level: AnyLevel) -> Array | None:
        """A mesh of the finest level on a coarser one; ``None`` where it is folded there."""
        ...

    def is_folded(self, mesh: Array, level: AnyLevel) -> bool:
        """Whether a first mesh is folded on the domain."""
        ...

    def lifted(
        self, way: AnyWay, mesh: Array, coarse: AnyLevel, fine: AnyLevel, objective: Callable[[], Objective]
    ) -> Array:
        """A mesh on a finer level, whose ``objective`` is asked for where it may fold."""
        ...

    def grid(self, level: AnyLevel) -> Grid | None:
        """The grid of a level; ``None`` on blocks."""
        ...

    def mesh(self, level: AnyLevel, mesh: Array) -> AnyMesh:
        """The mesh for the records."""
        ...

    def min_jacobian(self, level: AnyLevel, mesh: Array) -> float:
        """The smallest Jacobian of a corner, relative to the initial mesh."""
        ...
