"""Nested grids, and ways to a mesh on them: where the descent starts, and how it goes up from grid to grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from equimesh.domains.closing import closed_of
from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.fields.field import Field
from equimesh.least_error.cells import Cells, cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.elements import Norm
from equimesh.least_error.levels import GridLevel, nested_levels
from equimesh.least_error.objective import Objective
from equimesh.least_error.starts import product, rectilinear, resampled
from equimesh.meshes.closed import Closed, closed_mesh, interpolated_across, interpolated_closed
from equimesh.meshes.grid import Grid
from equimesh.meshes.interpolation import interpolated_values
from equimesh.meshes.mesh import Mesh
from equimesh.numerics.types import Array

OPEN: Closed = (False, False)
"""No lines are closed."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Way:
    """The straight lines ``s`` and ``t`` from which cells are measured and displaced, on grids of any size."""

    name: str
    s: Array
    t: Array
    closed: Closed = OPEN
    """Whether lines along xi, and those along eta, are closed."""
    _starts: dict[Grid, Array] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def uniform(cls, name: str = "uniform", closed: Closed = OPEN) -> Way:
        """From the uniform mesh."""
        ends = np.array([0.0, 1.0])
        return cls(name=name, s=ends, t=ends, closed=closed)

    @classmethod
    def given(cls, mesh: Mesh, closed: Closed = OPEN) -> Way:
        """From a given mesh on its own grid, where no mesh with a lower objective has a larger error; else uniform."""
        way = cls.uniform("given", closed)
        way._starts[mesh.grid] = coordinates_of(mesh)
        return way

    @property
    def is_uniform(self) -> bool:
        """Whether the first meshes are uniform."""
        return self.s.size == self.t.size == 2

    def start(self, grid: Grid) -> Array:
        """The first mesh on a grid, shape ``(2, nodes)``."""
        if grid not in self._starts:
            s = resampled(self.s, grid.n_xi, closed=self.closed[0])
            self._starts[grid] = product(s, resampled(self.t, grid.n_eta, closed=self.closed[1]))
        return self._starts[grid]

    def lifted(self, mesh: Array, coarse: Grid, fine: Grid, domain: Domain = UNIT_SQUARE) -> Array:
        """A ``mesh`` on a finer grid: its displacements by cubic, else linear interpolation, else its positions.

        Linear interpolation of positions does not fold where every coarse line is a fine one. The first mesh of the
        grid where all of them fold: in the ``domain`` where lines are closed, else in the reference square.
        """
        if any(self.closed):
            return self._lifted_across(mesh, coarse, fine, domain)
        start, first = self.start(fine), self.start(coarse)
        nothing = np.zeros(1)
        for origin, cubic, added in ((first, True, start), (first, False, start), (nothing, False, nothing)):
            parts = (mesh - origin).reshape(2, *coarse.shape)
            moved = [interpolated_values(part, fine.shape, cubic=cubic).reshape(-1) for part in parts]
            lifted = (np.stack(moved) + added).reshape(2, *fine.shape)
            for ends in (lifted[0], lifted[1].T):
                ends[0], ends[-1] = 0.0, 1.0
            flat = lifted.reshape(2, -1)
            if not mesh_of(flat, fine).is_folded:
                return flat
        return start

    def _lifted_across(self, mesh: Array, coarse: Grid, fine: Grid, domain: Domain) -> Array:
        """As :meth:`lifted`, for a mesh with closed lines: displacements and positions go on across its seams."""
        start, first = self.start(fine), self.start(coarse)
        parts = (mesh - first).reshape(2, *coarse.shape)
        for cubic in (True, False):
            moved = [interpolated_across(part, fine.shape, self.closed, cubic=cubic).reshape(-1) for part in parts]
            lifted = closed_mesh(mesh_of(np.stack(moved) + start, fine), self.closed)
            if not map_mesh(lifted, domain).is_folded:
                return coordinates_of(lifted)
        lifted = interpolated_closed(mesh_of(mesh, coarse), fine, self.closed, cubic=False)
        return start if map_mesh(lifted, domain).is_folded else coordinates_of(lifted)


@dataclass(frozen=True, kw_only=True)
class GridNest:
    """The nested grids up to ``finest`` on a ``domain``, as a :class:`~equimesh.least_error.nest.Nest`."""

    domain: Domain
    finest: Grid

    @cached_property
    def levels(self) -> list[GridLevel]:
        """The nested grids."""
        return nested_levels(self.finest)

    @property
    def is_regular(self) -> bool:
        """True: lines of a grid run from side to side."""
        return True

    @cached_property
    def closed(self) -> Closed:
        """Whether lines along xi, and those along eta, are closed."""
        return closed_of(self.domain)

    def chart(self, level: GridLevel) -> DomainChart:  # noqa: ARG002
        """The map of the domain."""
        return DomainChart(self.domain)

    def cells(self, level: GridLevel, *, are_cut: bool) -> Cells:  # noqa: ARG002
        """The cells of the grid."""
        return cells_of_grid(level.grid.shape, self.closed)

    def initial(self, level: GridLevel) -> Array:
        """The uniform mesh."""
        return coordinates_of(Mesh.uniform(level.grid))

    def start(self, way: Way, level: GridLevel) -> Array:
        """The first mesh of a way."""
        return way.start(level.grid)

    def uniform(self) -> Way:
        """The way from the uniform mesh."""
        return Way.uniform(closed=self.closed)

    def rectilinear(self, u: Field, norm: Norm, most: int, floor: float) -> Way | None:
        """The way from straight lines, at most ``most`` of each family."""
        counts = min(self.finest.n_xi, most), min(self.finest.n_eta, most)
        lines = rectilinear(u, self.domain, counts, norm, floor, closed=self.closed)
        return None if lines is None else Way(name="rectilinear", s=lines[0], t=lines[1], closed=self.closed)

    def given(self, mesh: Mesh) -> Way:
        """The way from a mesh of the finest grid."""
        return Way.given(mesh, self.closed)

    def from_coarse(self, mesh: Mesh) -> Way:  # noqa: ARG002
        """The way that continues from such a mesh on a coarse grid: distortion is that of the uniform mesh."""
        return Way.uniform("given", self.closed)

    def sampled(self, mesh: Mesh, level: GridLevel) -> Array | None:
        """A mesh of the finest grid on a coarser one; ``None`` where it is folded there."""
        if any(self.closed):
            sampled = coordinates_of(interpolated_closed(mesh, level.grid, self.closed))
            return None if self.is_folded(sampled, level) else sampled
        sampled = np.stack([interpolated_values(q, level.grid.shape).reshape(-1) for q in (mesh.x, mesh.y)])
        return None if mesh_of(sampled, level.grid).is_folded else sampled

    def is_folded(self, mesh: Array, level: GridLevel) -> bool:
        """Whether a mesh is folded on the domain. Few lines around a ring can lie so far apart that their cells are."""
        return any(self.closed) and map_mesh(mesh_of(mesh, level.grid), self.domain).is_folded

    def lifted(
        self,
        way: Way,
        mesh: Array,
        coarse: GridLevel,
        fine: GridLevel,
        objective: Callable[[], Objective],  # noqa: ARG002
    ) -> Array:
        """A mesh on a finer grid."""
        return way.lifted(mesh, coarse.grid, fine.grid, self.domain)

    def grid(self, level: GridLevel) -> Grid:
        """The grid of a level."""
        return level.grid

    def mesh(self, level: GridLevel, mesh: Array) -> Mesh:
        """The mesh of the reference square."""
        return mesh_of(mesh, level.grid)

    def min_jacobian(self, level: GridLevel, mesh: Array) -> float:
        """The smallest Jacobian of a corner on the domain, over its area."""
        return map_mesh(mesh_of(mesh, level.grid), self.domain).min_jacobian / self.domain.area


def mesh_of(mesh: Array, grid: Grid) -> Mesh:
    """The mesh of the reference square with these coordinates, shape ``(2, nodes)``."""
    return Mesh(mesh[0].reshape(grid.shape), mesh[1].reshape(grid.shape))


def coordinates_of(mesh: Mesh) -> Array:
    """The coordinates of a mesh of the reference square, shape ``(2, nodes)``."""
    return np.stack([mesh.x.reshape(-1), mesh.y.reshape(-1)])
