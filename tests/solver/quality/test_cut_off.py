"""How much of a domain meshes cut off; the bound that a mesh of least error keeps."""

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh, MeshRows
from equimesh.meshes.rows import Rows
from equimesh.quality.measures import CutOff, measure_cut_off
from equimesh.solving.least_error import is_no_worse
from equimesh.testing.geometries import l_shape, ring

RING = em.AnnulusSector(closed=True)
PEAK = "exp(-19.297*((x-1.2934)**2+(y-0.4535)**2))"


def bunched(n: int, share: float) -> Mesh:
    """Lines around a ring, crowded at one angle."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, n), np.linspace(0.0, 1.0, n), indexing="ij")
    return Mesh(s, t + share * np.sin(2.0 * math.pi * t) / (2.0 * math.pi))


def test_a_uniform_mesh_of_a_ring_has_that_of_a_polygon() -> None:
    cut, step = measure_cut_off(RING, MeshRows.of(bunched(25, 0.0))), 2.0 * math.pi / 24
    # The inner circle's chords cover the hole, the outer one's leave out of the ring: both count.
    assert cut.share == pytest.approx(5.0 * 12.0 * (step - math.sin(step)) / (3.0 * math.pi), rel=3e-3)
    assert cut.share == pytest.approx(cut.initial, rel=1e-12)
    assert not cut.is_much


def test_parts_of_rows_add_up_and_straight_domains_have_none() -> None:
    mesh = bunched(25, 0.8)
    whole = measure_cut_off(em.AnnulusSector(), MeshRows.of(mesh)).share
    parts = [
        MeshRows(mesh.x[a : b + 1], mesh.y[a : b + 1], Rows(shape=(25, 25), begin=a, end=b + 1, first=a, last=b))
        for a, b in ((0, 9), (9, 24))
    ]
    assert sum(measure_cut_off(em.AnnulusSector(), part).share for part in parts) == pytest.approx(whole, rel=1e-12)
    assert measure_cut_off(em.Rectangle(), MeshRows.of(mesh)) == CutOff(share=0.0, initial=0.0)


def test_meshes_of_blocks_are_measured_on_their_curves() -> None:
    domain = ring(500)
    initial = measure_cut_off(domain, domain.mesh)
    assert 0.0 < initial.share < 0.05
    assert initial.share == pytest.approx(initial.initial, rel=1e-9)
    angles, radii = np.arctan2(*domain.mesh.points.T[::-1]), np.hypot(*domain.mesh.points.T)
    angles = angles + 0.95 * np.sin(angles)
    moved = domain.mesh.moved(np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=1))
    assert measure_cut_off(domain, moved).share > 2.0 * initial.share
    straight = l_shape(200)
    assert measure_cut_off(straight, straight.mesh) == CutOff(share=0.0, initial=0.0)


def test_long_cells_follow_their_curve() -> None:
    found = em.solve(em.Problem(monitor=em.LeastError(u="tanh(20*(x - 0.3))"), domain=ring(1000)))
    assert found.cut_off.share < 0.02  # 0.085 without a weight
    assert found.gain > 60.0


def test_a_mesh_beyond_the_bound_is_no_gain_and_is_not_kept() -> None:
    problem = em.Problem(monitor=em.LeastError(u=PEAK), domain=RING, grid=em.Grid(n_xi=17, n_eta=17))
    found = em.solve(problem)
    assert is_no_worse(found, "l2")
    assert found.cut_off.share <= found.cut_off.most * (1.0 + 1e-6)
    even = Mesh.uniform(problem.grid)
    much = Mesh(even.x, 0.1 * even.y + 0.9 * even.y**6)  # the last cells around the ring are long
    beyond = replace(found, reference=much, mesh=em.solve(problem, initial=much).mesh)
    assert beyond.cut_off.is_much
    assert not is_no_worse(beyond, "l2")
    assert not em.solve(problem, initial=much).cut_off.is_much
