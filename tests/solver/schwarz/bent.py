"""A solution with all nodes moved, and subdomains with the optimized condition to solve from there."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.schwarz.merged_mesh import MergedMeshes
from equimesh.schwarz.optimized import OptimizedSubdomains
from equimesh.single_domain import iteration as single_domain


def bent(case: em.Problem, size: float) -> em.Mesh:
    """The solution with all nodes moved smoothly, those on sides along them."""
    *_, step = single_domain.single_domain_steps(case)
    x, y = step.mesh.x, step.mesh.y
    return em.Mesh(x + size * np.sin(np.pi * x) * np.cos(2 * y + x), y + size * np.sin(np.pi * y) * np.cos(3 * x - y))


def distance(one: em.Mesh, other: em.Mesh) -> float:
    return float(max(abs(one.x - other.x).max(), abs(one.y - other.y).max()))


def yielding_subdomains(
    case: em.Problem, decomposition: em.Decomposition, condition: em.Optimized
) -> OptimizedSubdomains:
    """All subdomains with the optimized condition, solved by Newton's method."""
    return OptimizedSubdomains(
        case, MergedMeshes(decomposition), condition, em.LocalSolver.NEWTON, in_turns=False, enough=0.0, threads=1
    )
