"""Guarded Newton solves of mesh equations."""

from __future__ import annotations

import numpy as np

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import newton_steps
from equimesh.numerics import newton


def test_the_guard_is_what_keeps_the_mesh_unfolded() -> None:
    """Without the demand for positive Jacobians, Newton converges to a folded root of the same equations."""
    case = problem("wave", 17, a=0.9)
    equations, start = case.equations(), em.Mesh.uniform(case.grid)
    folded = []
    for record in newton.newton_iterations(
        equations.residual,
        equations.jacobian,
        equations.vector(start),
        admissible=lambda z: bool(np.isfinite(z).all()),
        tolerance=1e-9,
        factorise=newton.superlu,
    ):
        folded.append(equations.mesh(record.z).is_folded)
        if record.step == 60:
            break
    assert any(folded)
    assert not any(solution.mesh.is_folded for solution in newton_steps(equations, start, most_steps=20))
