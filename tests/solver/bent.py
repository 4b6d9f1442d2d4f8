"""Meshes with uneven cells, shapes of domains, and the remainder of a Taylor expansion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import equimesh as em
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.charts import DomainChart
from equimesh.least_error.kernels import Rule
from equimesh.least_error.objective import Objective, Weights
from equimesh.least_error.starts import coordinates_of
from equimesh.numerics.types import Array

RING = em.Expression("tanh(12*((x - 0.4)**2 + (y - 0.6)**2 - 0.2))")
SECTOR = em.AnnulusSector(center=(0.3, -0.4), radii=(0.6, 1.4), angles=(10.0, 100.0))
CURVED = em.Quadrilateral(
    bottom=em.Curve.of_expressions("t", "0.2*sin(pi*t)"),
    right=em.Curve.of_expressions("1 + 0.1*sin(pi*t)", "t"),
    top=em.Curve.of_expressions("t", "1 + 0.1*sin(2*pi*t)"),
    left=em.Curve.of_expressions("-0.1*sin(pi*t)", "t"),
)
DOMAINS = {"square": em.Rectangle(), "sector": SECTOR, "curved": CURVED}
WEIGHTS = Weights(distortion=0.03, smoothness=0.1)


def uniform(grid: em.Grid) -> Array:
    """The uniform mesh, shape ``(2, nodes)``."""
    return coordinates_of(em.Mesh.uniform(grid))


def bent(grid: em.Grid, seed: int = 0, share: float = 0.2) -> Array:
    """The uniform mesh with every node moved by up to ``share`` of a cell; nodes of sides along these."""
    moves = np.random.default_rng(seed).uniform(-share, share, (2, grid.points))
    moves *= cells_of_grid(grid.shape).free / (np.array(grid.shape)[:, None] - 1)
    return uniform(grid) + moves


def objective_on(
    grid: em.Grid,
    u: em.Field = RING,
    domain: em.Domain = DOMAINS["square"],
    *,
    start: Array | None = None,
    weights: Weights = WEIGHTS,
    rule: Rule | None = None,
    threads: int = 1,
) -> Objective:
    """The objective on a grid, relative to the uniform mesh unless ``start`` is given."""
    first = uniform(grid) if start is None else start
    return Objective(u, DomainChart(domain), cells_of_grid(grid.shape), first, weights, rule or Rule(), threads)


def remainders(value: Callable[[float], float], slope: float, step: float) -> tuple[float, float]:
    """``|value(h) - value(0) - h slope|`` at ``step`` and at half of it: the first is 4 times the second."""
    first, second = (abs(value(h) - value(0.0) - h * slope) for h in (step, 0.5 * step))
    return first, second
