"""The map of a mesh and its inverse."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.fields.mesh_map import MeshMap, reference_of
from solver.fields.bent_meshes import ANYWHERE, largest


def test_the_inverse_of_the_map_leads_back(front: em.Mesh) -> None:
    of = MeshMap.of(front)
    places = of.locate(*ANYWHERE)
    assert places.smooth.all()
    back = [part.evaluate(places.s, places.t)[0] for part in (of.x, of.y)]
    assert largest(tuple(back), tuple(ANYWHERE)).max() < 1e-12
    nodes = of.locate(front.x, front.y)
    i, j = np.indices(front.x.shape)
    assert np.abs(nodes.s - i.ravel()).max() < 1e-9
    assert np.abs(nodes.t - j.ravel()).max() < 1e-9


def test_the_way_back_from_a_domain(front: em.Mesh) -> None:
    ring = em.AnnulusSector(center=(0.3, 0.0), radii=(0.5, 2.0), angles=(10, 130))
    for domain in (em.Rectangle(x=(-1.0, 3.0), y=(0.0, 0.5)), ring):
        back = reference_of(map_mesh(front, domain), domain)
        assert max(np.abs(back.x - front.x).max(), np.abs(back.y - front.y).max()) < 1e-13
