"""Ways to a mesh: where the descent starts, and how it goes up from grid to grid."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from equimesh.domains.domain import UNIT_SQUARE, Domain, map_mesh
from equimesh.least_error.objective import Weights
from equimesh.least_error.starts import product, resampled
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
    weights: Weights
    closed: Closed = OPEN
    """Whether lines along xi, and those along eta, are closed."""
    _starts: dict[Grid, Array] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def uniform(cls, weights: Weights, name: str = "uniform", closed: Closed = OPEN) -> Way:
        """From the uniform mesh."""
        ends = np.array([0.0, 1.0])
        return cls(name=name, s=ends, t=ends, weights=weights, closed=closed)

    @classmethod
    def given(cls, weights: Weights, mesh: Mesh, closed: Closed = OPEN) -> Way:
        """From a given mesh on its own grid, where no mesh with a lower objective has a larger error; else uniform."""
        way = cls.uniform(weights, "given", closed)
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


def mesh_of(mesh: Array, grid: Grid) -> Mesh:
    """The mesh of the reference square with these coordinates, shape ``(2, nodes)``."""
    return Mesh(mesh[0].reshape(grid.shape), mesh[1].reshape(grid.shape))


def coordinates_of(mesh: Mesh) -> Array:
    """The coordinates of a mesh of the reference square, shape ``(2, nodes)``."""
    return np.stack([mesh.x.reshape(-1), mesh.y.reshape(-1)])
