"""The checks of cells and faces, against the numbers that OpenFOAM's ``checkMesh`` prints."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.quality.faces import check_cells
from solver.quality.test_faces import waves


@pytest.mark.parametrize(
    ("mesh", "determinant", "weight", "volume_ratio"),
    [
        (waves((17, 13), em.Rectangle()), 0.1086889587357588, 0.444632629272834, 0.6838339028141148),
        (waves((9, 25), em.AnnulusSector()), 0.09539239440834739, 0.4047638058692445, 0.5387267305538241),
    ],
)
def test_the_numbers_of_check_mesh(mesh: Mesh, determinant: float, weight: float, volume_ratio: float) -> None:
    """Those of ``checkMesh -allTopology -allGeometry`` of OpenFOAM 1912 for the same nodes, one cell thick."""
    checks = check_cells(mesh)
    assert checks.determinant == pytest.approx(determinant, rel=1e-12)
    assert checks.weight == pytest.approx(weight, rel=1e-12)
    assert checks.volume_ratio == pytest.approx(volume_ratio, rel=1e-12)
    assert checks.passed


def test_thin_cells_sudden_changes_and_folds_do_not_pass() -> None:
    def product(x: np.ndarray, y: np.ndarray) -> Mesh:
        return Mesh(*np.meshgrid(x, y, indexing="ij"))

    even = np.linspace(0.0, 1.0, 9)
    assert check_cells(product(even, even)).passed
    thin = check_cells(product(even, even / 100))
    assert thin.determinant < 0.001
    assert not thin.passed
    sudden = check_cells(product(np.array([0.0, 0.01, 0.5, 1.0]), np.linspace(0.0, 1.0, 4)))
    assert sudden.weight == pytest.approx(0.01 / 0.5)
    assert sudden.volume_ratio == pytest.approx(0.01 / 0.49)
    assert not sudden.passed
    folded = product(even[[0, 2, 1, 3]], even)
    assert math.isnan(check_cells(folded).determinant)
    assert not check_cells(folded).passed
