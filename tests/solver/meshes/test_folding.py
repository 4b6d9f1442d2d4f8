"""The smallest corner Jacobian of a mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.meshes.mesh import smallest_jacobian


def test_smallest_jacobian_is_that_of_the_mesh() -> None:
    mesh = em.solve(problem("paper", 12)).mesh
    assert smallest_jacobian(mesh.x, mesh.y) * 11 * 11 == pytest.approx(mesh.corner_jacobians().min())
    broken = mesh.x.copy()
    broken[3, 4] = np.nan
    assert np.isnan(smallest_jacobian(broken, mesh.y))
    assert em.Mesh(broken, mesh.y).is_folded
