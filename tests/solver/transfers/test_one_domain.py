"""Meshes of one domain, and of two."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.transfers.one_domain import first_beyond, require_one_domain, require_valid
from solver.fields.bent_meshes import smooth_mesh

RING = em.AnnulusSector(radii=(1.0, 2.0), angles=(0, 180))


@pytest.mark.parametrize(
    "domain",
    [
        em.Rectangle(x=(100.0, 103.0), y=(-1.0, 1.0)),
        RING,
        em.AnnulusSector(angles=(0, 360)),
        em.Quadrilateral(
            bottom=em.Curve.of_expressions("t", "0.2*sin(6*t)*(1 - t)"),
            right=em.Curve.through([[1.0, 0.0], [1.3, 0.5], [1.0, 1.0]]),
            top=em.Curve.through([[0.0, 1.0], [1.0, 1.0]]),
            left=em.Curve.through([[0.0, 0.0], [0.0, 1.0]]),
        ),
    ],
)
def test_meshes_of_one_domain_pass(domain: em.Domain) -> None:
    for one, other in ((12, 16), (33, 12), (17, 17)):
        pair = smooth_mesh(one, depth=0.05), smooth_mesh(other, depth=-0.03)
        require_one_domain(*(map_mesh(em.Mesh.of_unit_square(m.x, m.y), domain) for m in pair))


def test_the_way_of_numbering_does_not_matter() -> None:
    old, new = smooth_mesh(9), smooth_mesh(12)
    require_one_domain(old, em.Mesh(1.0 - new.y, new.x.copy()))


def test_a_ring_of_a_slightly_larger_radius_is_another_domain() -> None:
    old, new = (map_mesh(em.Mesh.uniform(em.Grid(n_xi=33, n_eta=33)), RING) for _ in range(2))
    require_one_domain(old, new)
    with pytest.raises(InputError, match="of one domain"):
        require_one_domain(old, em.Mesh(1.02 * new.x, 1.02 * new.y))


def test_the_part_of_a_mesh_is_another_domain() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    part = em.Mesh(mesh.x[:5], mesh.y[:5])
    for pair in ((mesh, part), (part, mesh)):
        with pytest.raises(InputError, match="of one domain"):
            require_one_domain(*pair)


def test_a_mesh_of_few_nodes_is_not_valid() -> None:
    mesh = smooth_mesh(4)
    require_valid(mesh)
    with pytest.raises(InputError, match=r"a mesh is needed, .* not the text 'x'"):
        require_valid("x")
    with pytest.raises(InputError, match="a mesh has 3 x 7 nodes"):
        require_valid(em.Mesh(mesh.x[:3], mesh.y[:3]))


def test_the_first_point_that_is_too_far_is_found() -> None:
    edges = np.array([[0.0, 0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 1.0, 0.1]])
    points = np.array([[0.5, 0.0], [1.05, 0.5], [0.5, 0.05]])
    assert first_beyond(points[:2], edges, 1e-9) == -1
    assert first_beyond(points, edges, 1e-9) == 2
    assert first_beyond(points, edges, 0.06) == -1
