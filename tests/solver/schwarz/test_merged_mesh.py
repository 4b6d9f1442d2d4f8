"""What is done with merged meshes of the whole grid."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.schwarz.decomposition import SubdomainWindow
from equimesh.schwarz.merged_mesh import MergedMeshes

GRID = em.Grid(n_xi=14, n_eta=11)
BLOCKS = em.Decomposition(grid=GRID, subdomains=(3, 2), overlap=2)
MERGED = MergedMeshes(BLOCKS)


def test_products_are_those_of_all_nodes() -> None:
    random = np.random.default_rng(3)
    one, other = (em.Mesh(*random.normal(size=(2, *GRID.shape))) for _ in range(2))
    found = MERGED.products([(one, other), (one, one)])
    assert found[0] == pytest.approx(np.vdot(one.x, other.x) + np.vdot(one.y, other.y))
    assert found[1] == pytest.approx(np.sum(one.x**2 + one.y**2))


def test_a_turn_writes_its_places_in_its_order() -> None:
    windows = [SubdomainWindow(BLOCKS, part, 1) for part in BLOCKS.parts]
    mesh = em.Mesh.uniform(GRID)
    states = {k: em.Mesh(np.full(w.shape, float(k)), np.full(w.shape, -float(k))) for k, w in enumerate(windows)}
    MERGED.merge([1, 0], states, windows, {k: windows[k].covered for k in (0, 1)}, windows, mesh)
    assert (mesh.x[windows[0].covered] == 0).all(), "the last one to write"
    assert (mesh.x[: windows[1].covered[0].stop, windows[0].covered[1].stop :] == 1).all()
    assert mesh.x[-1, -1] == 1.0
    assert mesh.y[-1, 1] == pytest.approx(0.1), "those of other turns stay"
