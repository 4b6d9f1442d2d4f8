"""What lies between two times."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.sequences.pursuit import Between, blocks_between, mesh_between
from equimesh.testing import check_field
from equimesh.testing.geometries import l_shape
from solver.fields.bent_meshes import smooth_mesh


def test_u_between_two_times_is_a_field() -> None:
    field = Between(earlier=em.Expression("x*x"), later=em.Expression("sin(y)"), share=0.25)
    check_field(field, ((0.0, 1.0), (0.0, 1.0)))
    (u,) = field.evaluate(np.array([0.5]), np.array([0.3]))
    assert u[0] == 0.75 * 0.25 + 0.25 * np.sin(0.3)


def test_a_smoothed_mesh_has_a_share_of_the_one_before() -> None:
    before, new = smooth_mesh(9), smooth_mesh(9, depth=-0.05)
    mesh = mesh_between(before, new, 0.3)
    assert np.abs(mesh.x - (0.7 * new.x + 0.3 * before.x)).max() < 1e-14


def test_the_share_falls_where_a_cell_would_fold() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=5))
    x, y = uniform.x - 0.5, uniform.y - 0.5
    inner = np.pad(np.ones((3, 3)), 1)
    before = em.Mesh(uniform.x + 9.0 * inner * y, uniform.y - 9.0 * inner * x)
    mesh = mesh_between(before, uniform, 0.9)
    assert not mesh.is_folded
    assert 0.0 <= np.abs(mesh.x - uniform.x).max() < 0.9 * 9.0 * 0.25


def test_a_mesh_of_blocks_between_two_is_not_folded() -> None:
    domain = l_shape(300)
    mesh = domain.mesh
    far = mesh.moved(mesh.points[::-1].copy())
    for share in (0.9, 0.5):
        assert not blocks_between(domain, far, mesh, share).is_folded
    assert blocks_between(domain, mesh, mesh, 0.5).distance(mesh) < 1e-12
    shifted = mesh.points.copy()
    shifted[domain.node_curve == -1] += 0.01
    middle = blocks_between(domain, mesh.moved(shifted), mesh, 0.5)
    assert np.abs(middle.points - mesh.points)[domain.node_curve == -1] == pytest.approx(0.005)
