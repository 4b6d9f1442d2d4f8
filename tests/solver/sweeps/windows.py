"""Sweeps on whole grids, meshes that are no solutions, and the distance of two meshes."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.meshes.rows import Rows
from equimesh.sweeps import sweep as chord


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return max(abs(one.x - other.x).max(), abs(one.y - other.y).max())


def sweep_on(case: em.Problem, threads: int = 1) -> chord.Sweep:
    return chord.Sweep(
        case.metric, case.boundary, Rows.whole(case.grid.shape, threads), np.empty(chord.memory_needed(case.grid.shape))
    )


def disturbed(case: em.Problem, size: float = 0.01) -> em.Mesh:
    uniform, random = em.Mesh.uniform(case.grid), np.random.default_rng(3)
    inside = np.zeros(case.grid.shape)
    inside[1:-1, 1:-1] = size
    noise = [inside * random.standard_normal(case.grid.shape) for _ in range(2)]
    return em.Mesh(uniform.x + noise[0], uniform.y + noise[1])
