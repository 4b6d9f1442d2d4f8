"""Meshes that the tests of the coupling share."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh import Mesh
from equimesh_coupling import MeshParts


def bent(n_xi: int = 7, n_eta: int = 5) -> Mesh:
    """A mesh of curved lines that is neither uniform nor symmetric."""
    xi, eta = np.meshgrid(np.linspace(0, 1, n_xi), np.linspace(0, 1, n_eta), indexing="ij")
    return Mesh(xi + 0.1 * np.sin(3 * eta) + 0.1 * xi * eta, eta + 0.2 * xi**2)


@pytest.fixture
def mesh() -> Mesh:
    """The mesh of the solver itself, 7 by 5 nodes."""
    return bent()


@pytest.fixture
def quads() -> MeshParts:
    """Quadrilaterals, 7 by 5 nodes."""
    return bent().mesh_parts()


@pytest.fixture
def triangles() -> MeshParts:
    """The same nodes with triangles."""
    return bent().mesh_parts("triangle")


@pytest.fixture(params=["quad", "triangle"])
def parts(request: pytest.FixtureRequest) -> MeshParts:
    """Both kinds of cells."""
    return bent().mesh_parts(request.param)
