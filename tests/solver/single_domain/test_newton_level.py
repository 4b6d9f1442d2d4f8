"""Levels without sweeps."""

from __future__ import annotations

import math

import equimesh as em
from equimesh.single_domain.continuation import Relaxation
from equimesh.single_domain.level import interpolated_level
from equimesh.single_domain.steps import Step


def step(points: int, **more: object) -> Step:
    grid = em.Grid(n_xi=points, n_eta=points)
    return Step(level=0, levels=2, grid=grid, step=0, residual=1.0, mesh=em.Mesh.uniform(grid), **more)  # type: ignore[arg-type]


def test_a_level_that_is_interpolated_names_the_grid_that_was_solved() -> None:
    relaxed = step(17, relaxation=Relaxation(strength=0.5))
    found = interpolated_level(step(33), relaxed)
    assert (found.relaxation, found.solved, found.converged) == (relaxed.relaxation, relaxed.grid, True)
    assert math.isnan(found.residual)
    again = interpolated_level(step(65), found)
    assert again.solved == relaxed.grid
    assert not again.is_exact
