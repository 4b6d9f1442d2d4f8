"""Closed lines: working memory, finer grids, nodes that are one, and copies beyond periodic joins."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import joins_of
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.mesh_data import joined
from equimesh.meshes.nested import (
    Closed,
    closed_mesh,
    distance_closed,
    interpolated_closed,
    padded,
    padded_shape,
    prolong_closed,
    tied_nodes,
    unpadded,
)
from equimesh.meshes.unrolled import Unrolled, moves_of, translations_of
from solver.meshes.quad_cases import disc, strip

CASES = [(True, False), (False, True), (True, True)]


def waved(n: int, closed: Closed, shift: float = 0.0) -> em.Mesh:
    """A smooth mesh with bent seams; ``shift`` is where its lines begin."""
    line = np.linspace(0.0, 1.0, n)
    xi, eta = np.meshgrid(line + shift * closed[0], line + shift * closed[1], indexing="ij")
    bump = np.sin(2 * np.pi * xi) * np.sin(2 * np.pi * eta)
    return closed_mesh(em.Mesh(xi + 0.05 * bump + 0.03 * closed[0], eta + 0.04 * bump), closed)


@pytest.mark.parametrize("closed", CASES)
def test_working_memory_begins_with_the_nodes_before_the_seam(closed: Closed) -> None:
    mesh = waved(9, closed)
    memory = padded(mesh, closed)
    assert memory.x.shape == padded_shape(mesh.grid.shape, closed)
    back = unpadded(memory.x, memory.y, closed)
    assert back.distance(mesh) == 0.0
    if closed[0]:
        assert np.array_equal(back.x[-2], memory.x[0, int(closed[1]) :] + 1.0)


@pytest.mark.parametrize("closed", CASES)
@pytest.mark.parametrize("n", [33, 30])
def test_finer_meshes_do_not_depend_on_where_lines_begin(closed: Closed, n: int) -> None:
    fine = prolong_closed(waved(17, closed), em.Grid(n_xi=n, n_eta=n), closed, waved(9, closed))
    exact = waved(n, closed)
    assert fine.distance(exact) < 4e-4
    other = prolong_closed(waved(17, closed, 0.25), em.Grid(n_xi=n, n_eta=n), closed, waved(9, closed, 0.25))
    if n == 33:
        rolled = np.roll(other.x[:-1, :-1], [8 * c for c in closed], (0, 1))
        assert np.abs((rolled - fine.x[:-1, :-1] + 0.5) % 1.0 - 0.5).max() < 1e-14


@pytest.mark.parametrize("closed", CASES)
def test_the_distance_is_that_at_common_nodes_or_to_the_interpolant(closed: Closed) -> None:
    coarse = waved(17, closed)
    assert distance_closed(waved(33, closed), coarse, closed) < 1e-15
    fine = interpolated_closed(coarse, em.Grid(n_xi=30, n_eta=30), closed)
    assert distance_closed(fine, coarse, closed) < 1e-15
    assert distance_closed(em.Mesh(fine.x + 0.1, fine.y), coarse, closed) == pytest.approx(0.1)


def test_every_copy_is_tied_to_the_first_node() -> None:
    assert tied_nodes((3, 4), (False, False)).shape == (0, 2)
    assert tied_nodes((3, 4), (False, True)).tolist() == [[3, 0], [7, 4], [11, 8]]
    both = dict(tied_nodes((3, 4), (True, True)).tolist())
    assert both == {3: 0, 7: 4, 8: 0, 9: 1, 10: 2, 11: 0}


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


SQUARE = Mesh.uniform(Grid(n_xi=5, n_eta=4))
NUMBER = np.arange(20).reshape(5, 4)
ACROSS = np.column_stack([NUMBER[-1], NUMBER[0]])
UP = np.column_stack([NUMBER[:, -1], NUMBER[:, 0]])


def test_the_copy_has_the_edges_of_its_original() -> None:
    (join,) = joins_of(SQUARE.points, SQUARE.sides, ACROSS)
    assert (join.original, join.copy) == ("left", "right")
    assert np.array_equal(join.edges - 16, SQUARE.sides["left"])
    assert join.translation.tolist() == [1.0, 0.0]
    assert sorted(map(tuple, join.nodes)) == sorted(map(tuple, ACROSS))
    (other,) = joins_of(SQUARE.points, SQUARE.sides, ACROSS[:, ::-1])
    assert (other.original, other.copy) == ("right", "left")
    assert other.translation.tolist() == [-1.0, 0.0]


def test_both_directions_may_be_joined() -> None:
    one, two = joins_of(SQUARE.points, SQUARE.sides, np.concatenate([ACROSS, UP[:-1]]))
    assert {(one.original, one.copy), (two.original, two.copy)} == {("left", "right"), ("bottom", "top")}
    assert np.array_equal(two.edges - 3, SQUARE.sides[two.original])


def test_no_ties_no_joins() -> None:
    assert joins_of(SQUARE.points, SQUARE.sides, ACROSS[:0]) == ()


def test_sides_that_are_joined_in_part_are_refused() -> None:
    with pytest.raises(InputError, match="the side left is joined in part, to several sides, or to itself"):
        joins_of(SQUARE.points, SQUARE.sides, ACROSS[:3])
    ends = {"ends": np.concatenate([SQUARE.sides["left"], SQUARE.sides["right"]])}
    with pytest.raises(InputError, match="the side ends is joined in part, to several sides, or to itself"):
        joins_of(SQUARE.points, ends, ACROSS)


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
