"""The gradient map by nested iteration: from a coarse grid to the requested one.

Where the shares of a density do not become equal, the map is that of a weaker density: a power of it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.fft import dctn, idctn

from equimesh.domains.domain import Domain
from equimesh.equations.problem import Problem
from equimesh.gradient_map.density import Density
from equimesh.gradient_map.level import MAX_DEVIATION, MapLevel, Placed
from equimesh.meshes.grid import Grid
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import Monitor
from equimesh.numerics.types import Array
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.steps import Step

MAX_COARSEST_CELLS = 15
"""Cells a side of the coarsest grid, at most."""
WEAKENING = 0.8
"""The power of a density that is tried next where the iteration fails."""
MIN_STRENGTH = 0.05
"""Smaller powers are not tried."""


def gradient_map_steps(problem: Problem) -> Iterator[Step]:
    """The steps up the nested grids to the gradient map of the problem's monitor.

    The last step has ``converged`` or ``failed`` set; its mesh is valid in any case. ``residual`` is the root mean
    square of the relative deviations of the cells' shares of the density from their mean.
    """
    yield from _climb(problem.monitor, problem.domain, problem.grid)


def _climb(monitor: Monitor, domain: Domain, grid: Grid) -> Iterator[Step]:
    density = Density.of(monitor, domain, grid)
    grids = _grids(grid)
    phi, strength = np.zeros(tuple(n - 1 for n in grids[0].shape)), 1.0
    if not density.is_finite:
        yield replace(_step(0, [grid], Mesh.uniform(grid)), failed=True)
        return
    for level, here in enumerate(grids):
        table, phi = density.on(here), _lifted(phi, here)
        strength = min(1.0, strength / WEAKENING)
        count = 0
        while True:
            weak = table if strength == 1.0 else table**strength
            placed = None
            for placed in MapLevel(grid=here, table=weak, extents=density.extents).steps(phi):
                yield _step(level, grids, _mesh(placed), count, placed.deviation, strength)
                count += 1
            if placed is None:
                raise AssertionError("the iteration yields at least its start")
            phi, deviation = placed.phi, placed.deviation
            if deviation <= MAX_DEVIATION:
                break
            strength *= WEAKENING
            if strength < MIN_STRENGTH:
                yield replace(_step(level, grids, Mesh.uniform(grid), count, deviation, 0.0), failed=True)
                return
        yield replace(_step(level, grids, _mesh(placed), count - 1, deviation, strength), converged=True)


def _step(
    level: int,
    grids: list[Grid],
    mesh: Mesh,
    count: int = 0,
    deviation: float = np.nan,
    strength: float = 1.0,
) -> Step:
    return Step(
        level=level,
        levels=len(grids),
        grid=mesh.grid,
        step=count,
        residual=deviation,
        mesh=mesh,
        relaxation=Relaxation(strength=strength),
    )


def _mesh(placed: Placed) -> Mesh:
    return Mesh(placed.x, placed.y)


def _grids(grid: Grid) -> list[Grid]:
    """Grids from coarse to fine, each with half the cells of the next in directions that have many."""
    grids = [grid]
    while max(grids[0].shape) - 1 > MAX_COARSEST_CELLS:
        n_xi, n_eta = (n // 2 + 1 if n - 1 > MAX_COARSEST_CELLS else n for n in grids[0].shape)
        grids.insert(0, Grid(n_xi=n_xi, n_eta=n_eta))
    return grids


def _lifted(phi: Array, grid: Grid) -> Array:
    """The potential on the cells of a finer grid: the same sum of cosines."""
    shape = tuple(n - 1 for n in grid.shape)
    if phi.shape == shape:
        return phi
    waves = np.zeros(shape)
    waves[: phi.shape[0], : phi.shape[1]] = dctn(phi, type=2, norm="ortho")
    finer: Array = idctn(waves, type=2, norm="ortho") * np.sqrt(waves.size / phi.size)
    return finer
