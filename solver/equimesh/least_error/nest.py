"""Nests: the nested meshes of a domain, and the first meshes on them, for grids and blocks alike."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from equimesh.fields.expression import Field
from equimesh.least_error.cells import Cells
from equimesh.least_error.charts import Chart
from equimesh.least_error.kernels import Norm
from equimesh.least_error.objective import Objective
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.numerics.types import Array, IntArray
from equimesh.schwarz.settings import Schwarz

# The nested meshes of a least-error solve, from coarse to fine, with the work on each.

COARSEST_CELLS = 8
"""Cells a side of the coarsest grid, or up to a half more."""
STEPS = ((17 * 17, 45), (33 * 33, 40), (65 * 65, 18), (129 * 129, 5), (257 * 257, 2))
"""Steps of descent, at most, on meshes of at most this many points."""
STEPS_BEYOND = 1
"""Steps on finer meshes, at most: the coarser ones have done the work."""
GAUSS_POINTS = ((9 * 9, 4), (17 * 17, 3))
"""Gauss points a direction and cell on meshes of at most this many points."""
GAUSS_POINTS_BEYOND = 2
"""On finer meshes."""
MAX_COMPARED_POINTS = {"interpolation": 17 * 17, "finite_element": 9 * 9}
"""Points of the mesh, at most, on which the starts are compared, by the purpose: the error of a solver takes longer."""
MAX_COARSE_POINTS = 40 * 40
"""Points, at most, of the mesh on which weights and monitors are compared."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Level(ABC):
    """One of the nested meshes."""

    number: int
    """0 for the coarsest mesh."""
    count: int
    """How many meshes there are."""

    @property
    @abstractmethod
    def points(self) -> int:
        """Number of nodes."""

    @property
    def is_finest(self) -> bool:
        """Whether the mesh is the requested one."""
        return self.number + 1 == self.count

    @property
    def steps(self) -> int:
        """Steps of descent."""
        return next((steps for points, steps in STEPS if self.points <= points), STEPS_BEYOND)

    @property
    def gauss_points(self) -> int:
        """Gauss points a direction and cell."""
        return next((count for points, count in GAUSS_POINTS if self.points <= points), GAUSS_POINTS_BEYOND)


@dataclass(frozen=True, kw_only=True)
class GridLevel(Level):
    """One of the nested grids."""

    grid: Grid

    @property
    def points(self) -> int:
        """Number of nodes."""
        return self.grid.points


AnyLevel = TypeVar("AnyLevel", bound=Level)


def nested_levels(grid: Grid) -> list[GridLevel]:
    """The levels up to ``grid``. The coarsest has about as many points in both directions, whatever the grid has."""
    halvings = [max(0, round(math.log2((n - 1) / COARSEST_CELLS))) for n in grid.shape]
    count = max(halvings) + 1
    levels = []
    for number in range(count):
        cells = [
            max(3, round((n - 1) / 2 ** max(halved - number, 0)))
            for n, halved in zip(grid.shape, halvings, strict=True)
        ]
        levels.append(GridLevel(number=number, count=count, grid=Grid(n_xi=cells[0] + 1, n_eta=cells[1] + 1)))
    return levels


def last_compared(levels: Sequence[Level], purpose: str = "interpolation") -> int:
    """The number of the finest level up to which the descents from all starts run."""
    most = MAX_COMPARED_POINTS[purpose]
    return max((level.number for level in levels if level.points <= most), default=0)


def coarse_level(levels: Sequence[AnyLevel]) -> AnyLevel:
    """The level on which weights and monitors are compared: one of those on which a solve begins."""
    first, *finer = levels
    return next((level for level in reversed(finer) if level.points <= MAX_COARSE_POINTS), first)


class Start(Protocol):
    """Where a descent starts on each of the nested meshes; its distortion is relative to these first meshes."""

    @property
    def name(self) -> str:
        """The name of the first mesh, for the records."""
        ...

    @property
    def is_uniform(self) -> bool:
        """Whether the first meshes are the initial ones of the domain."""
        ...


AnyMesh = TypeVar("AnyMesh", bound=Mesh)
AnyStart = TypeVar("AnyStart", bound=Start)


class Nest(Protocol[AnyLevel, AnyMesh, AnyStart]):
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

    @property
    def is_paved(self) -> bool:
        """Whether blocks are too small for coarser meshes, in whose place smooth displacements are."""
        ...

    @property
    def finest_cells(self) -> int:
        """Cells of the finest mesh."""
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

    def first_mesh(self, origin: AnyStart, level: AnyLevel) -> Array:
        """The first mesh of a start on this level."""
        ...

    def uniform(self) -> AnyStart:
        """The start from the initial mesh."""
        ...

    def rectilinear(self, u: Field, norm: Norm, most: int, floor: float, degree: int = 1) -> AnyStart | None:
        """The start from straight lines, at most ``most`` of each family; ``None`` where there are none.

        See :func:`~equimesh.least_error.starts.equidistributed`.
        """
        ...

    def given(self, mesh: AnyMesh) -> AnyStart:
        """The start from a mesh of the finest level."""
        ...

    def from_coarse(self, mesh: AnyMesh) -> AnyStart:
        """The start that continues from such a mesh on a coarse level."""
        ...

    def sampled(self, mesh: AnyMesh, level: AnyLevel) -> Array | None:
        """A mesh of the finest level on a coarser one; ``None`` where it is folded there."""
        ...

    def owners(self, settings: Schwarz) -> IntArray:
        """The number of the subdomain of each cell of the finest level, shape ``(cells,)``."""
        ...

    def is_folded(self, mesh: Array, level: AnyLevel) -> bool:
        """Whether a first mesh is folded on the domain."""
        ...

    def lifted(
        self, origin: AnyStart, mesh: Array, coarse: AnyLevel, fine: AnyLevel, objective: Callable[[], Objective]
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
