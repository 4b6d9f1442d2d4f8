"""What a loop does on meshes of grids and of blocks."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.adapt.loop import Rounds, record_of
from equimesh.rounds.recovery import ErrorEstimate
from equimesh.testing.geometries import l_shape

DOMAIN = l_shape(300)


def test_meshes_for_a_solver_have_arrays_of_their_own() -> None:
    grid = Rounds(grid=em.Grid(n_xi=5, n_eta=4), domain=em.Rectangle(), norm="l2", threads=1)
    blocks = Rounds(domain=DOMAIN, norm="l2", threads=1)
    first, moved, start = grid.first()
    assert (first.x.shape, moved, start) == ((5, 4), 0.0, "given")
    copy = grid.copied(first)
    copy.x[:] = 9.0
    assert first.x.max() == 1.0
    other = blocks.copied(blocks.first()[0])
    other.points[:] = 9.0
    assert DOMAIN.mesh.points.max() < 9.0


def test_the_record_of_values_on_blocks_has_their_estimates() -> None:
    mesh = DOMAIN.mesh
    values = np.sin(4 * mesh.x)
    record, following = Rounds(domain=DOMAIN, norm="l2", threads=1).known(mesh, values)
    known = ErrorEstimate.of(mesh, values, DOMAIN)
    assert (record.estimate, record.unresolved) == (known.estimate, known.unresolved)
    assert record_of(known, mesh, values).estimate_h1 == record.estimate_h1
    found, moved, start = following()
    assert isinstance(found, em.QuadMesh)
    assert moved > 0.0
    assert start == "whole"


def test_a_loop_on_blocks_adapts_to_values_and_to_averages() -> None:
    front = em.Expression("tanh(15*(x + y - 1))")

    def nodal(mesh: em.QuadMesh) -> np.ndarray:
        return front.evaluate(mesh.x, mesh.y)[0]

    def averages(mesh: em.QuadMesh) -> em.CellAverages:
        return em.CellAverages(front.evaluate(*mesh.points[mesh.cells].mean(axis=1).T)[0])

    for solve in (nodal, averages):
        seen: list[em.AdaptRound[em.QuadMesh]] = []
        found = em.adapt(solve, domain=DOMAIN, rounds=2, threads=1, observe=seen.append)
        assert [one.number for one in seen] == [0, 1, 2]
        assert found.rounds[0].mesh is DOMAIN.mesh
        assert found.estimate < 0.85 * found.rounds[0].estimate
        assert found.values.shape == DOMAIN.mesh.node_shape
        assert not found.mesh.is_folded


def test_what_cannot_be_used_on_blocks_is_refused() -> None:
    with pytest.raises(em.InputError, match="leave n out"):
        em.adapt(lambda mesh: mesh.x, 9, domain=DOMAIN)
    with pytest.raises(em.InputError, match="number of points a direction"):
        em.adapt(lambda mesh: mesh.x)
