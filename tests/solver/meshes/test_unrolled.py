"""Copies of a mesh beyond its periodic joins."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.unrolled import Unrolled, moves_of, translations_of
from solver.meshes.quad_cases import disc, strip


def test_without_joins_there_are_no_copies() -> None:
    mesh = disc(3)
    unrolled = Unrolled.of(mesh)
    assert np.array_equal(unrolled.nodes, np.arange(len(mesh.points)))
    assert (len(unrolled.search.links.cells), moves_of(mesh).tolist()) == (len(mesh.cells), [[0.0, 0.0]])


@pytest.mark.parametrize(("both", "copies"), [(False, 3), (True, 9)])
def test_copies_meet_at_the_joins(both: bool, copies: int) -> None:
    mesh = strip(5, 0.1, 0.03, both=both)
    unrolled = Unrolled.of(mesh)
    search, count = unrolled.search, len(mesh.cells)
    assert len(search.links.cells) == copies * count == copies * unrolled.cells
    assert {tuple(np.round(np.abs(one), 9)) for one in translations_of(mesh)} == {(1, 0), (1 - both, both)}
    # No edge of the mesh itself is left without a neighbour but those of walls.
    alone = (search.links.neighbours[:count] < 0).sum()
    assert alone == (0 if both else 2 * 5)
    # A copy is the mesh itself, translated.
    x, y = search.nodes
    for k, move in enumerate(moves_of(mesh)):
        cells = search.links.cells[k * count : (k + 1) * count]
        assert np.abs(np.stack([x[cells], y[cells]], axis=-1) - mesh.points[mesh.cells] - move).max() < 1e-12


def test_a_point_beyond_a_join_is_found() -> None:
    mesh = strip(6, 0.05, 0.02)
    unrolled = Unrolled.of(mesh)
    here, there = (unrolled.search.find(np.array([x]), np.array([0.4])) for x in (1.3, 0.3))
    assert here.cell % unrolled.cells == there.cell
    assert (here.s, here.t) == (pytest.approx(there.s), pytest.approx(there.t))


def test_a_sum_of_two_translations_is_no_third_one() -> None:
    mesh = strip(4, both=True)
    ties = np.concatenate([[[24, 0]], mesh.ties])  # the corner as a copy of the opposite one
    both = Mesh(points=mesh.points, cells=mesh.cells, sides={}, blocks=mesh.blocks, ties=ties)
    assert np.array_equal(translations_of(both), translations_of(mesh))
    neighbours = Unrolled.of(both).search.links.neighbours[: len(mesh.cells)] % len(mesh.cells)
    assert np.array_equal(neighbours, Unrolled.of(mesh).search.links.neighbours[: len(mesh.cells)] % len(mesh.cells))
