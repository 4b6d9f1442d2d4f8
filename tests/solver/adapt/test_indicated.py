"""The next mesh by an error indicator of the cells."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.adapt.loop import indicated_mesh
from equimesh.domains.domain import UNIT_SQUARE, map_mesh
from equimesh.quality.cells import BilinearCells

SECTOR = em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 60.0))


def uniform(n: int, m: int, domain: em.Domain = UNIT_SQUARE) -> em.Mesh:
    return map_mesh(em.Mesh.uniform(em.Grid(n_xi=n, n_eta=m)), domain)


def middles(mesh: em.Mesh) -> tuple[np.ndarray, np.ndarray]:
    return tuple(0.25 * (q[1:, 1:] + q[1:, :-1] + q[:-1, 1:] + q[:-1, :-1]) for q in (mesh.x, mesh.y))


@pytest.mark.parametrize("domain", [UNIT_SQUARE, SECTOR])
def test_cells_are_small_where_the_indicator_is_large(domain: em.Domain) -> None:
    mesh = uniform(17, 17, domain)
    x, y = middles(mesh)
    indicator = np.exp(-30.0 * (np.hypot(x, y) - 1.2) ** 2)
    found = indicated_mesh(mesh, indicator, domain, "l2", 1)
    assert found.min_jacobian > 0
    x, y = middles(found)
    area = BilinearCells(found).area.reshape(16, 16)
    near = np.abs(np.hypot(x, y) - 1.2) < 0.05
    far = np.abs(np.hypot(x, y) - 1.2) > 0.4
    assert area[near].mean() < 0.4 * area[far].mean()


def test_an_indicator_of_zero_keeps_the_mesh() -> None:
    mesh = uniform(9, 9)
    assert indicated_mesh(mesh, np.zeros((8, 8)), UNIT_SQUARE, "l2", 1) is mesh
