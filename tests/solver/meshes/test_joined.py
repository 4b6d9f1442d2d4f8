"""Closed structured meshes as meshes of quadrilaterals."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh_data import joined

UNIFORM = em.Mesh.uniform(em.Grid(n_xi=4, n_eta=9))


def test_the_nodes_of_a_ring_are_one_each_and_its_seam_is_no_side() -> None:
    mesh = map_mesh(UNIFORM, em.AnnulusSector(closed=True))
    ring = joined(mesh)
    assert len(ring.points) == 4 * 8
    assert {*ring.sides} == {"left", "right"}
    assert not ring.ties.size
    assert ring.periodic == ()
    assert not ring.is_folded
    assert np.array_equal(ring.points[ring.cells], mesh.points[mesh.cells])
    around = ring.sides["right"]
    assert np.array_equal(np.sort(around[:, 0]), np.sort(around[:, 1]))  # a closed line


def test_copies_that_lie_apart_are_tied_and_keep_their_sides() -> None:
    square = joined(map_mesh(UNIFORM, em.Rectangle(periodic="x")))
    assert len(square.points) == 4 * 9
    assert {*square.sides} == {"left", "right", "bottom", "top"}
    apart = square.points[square.ties[:, 0]] - square.points[square.ties[:, 1]]
    assert np.array_equal(apart, np.tile([1.0, 0.0], (9, 1)))
    (pair,) = square.periodic
    assert (pair.original, pair.copy) == ("left", "right")
    assert np.array_equal(pair.nodes, square.ties[np.argsort(square.ties[:, 0])])


def test_an_open_mesh_stays_as_it_is() -> None:
    found = joined(UNIFORM)
    assert np.array_equal(found.cells, UNIFORM.cells)
    assert not found.ties.size
