"""Nodes on the sides of the domain."""

from __future__ import annotations

import numpy as np

import equimesh as em
from cases import problem
from equimesh.single_domain import iteration


def test_the_sides_move_with_the_interior() -> None:
    """Nodes on the sides go where the equations of the sides want them, also at right angles to a moving interior."""
    for boundary in em.Boundary:
        case = problem("tanh20", 33, boundary=boundary, b=0.5)
        *_, last = iteration.single_domain_steps(case)
        equations = case.equations()
        assert abs(equations.residual(equations.vector(last.mesh))).max() < 1e-9 * equations.mean_flux(
            equations.vector(last.mesh)
        )
        assert abs(last.mesh.x[:, 0] - np.linspace(0, 1, 33)).max() > 1e-3
