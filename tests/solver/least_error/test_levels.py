"""Levels: from a coarse grid, or coarse blocks, to the requested mesh, with more work on coarse ones."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.least_error.block_levels import block_levels, edges_of
from equimesh.least_error.nest import COARSEST_CELLS, nested_levels
from equimesh.meshes.mesh import quads_of_block
from equimesh.testing.geometries import disc, l_shape, naca0012_c, pitz_daily, ring

SHAPES = [(65, 65), (129, 65), (40, 171), (4, 4), (5, 300), (9, 9), (17, 16), (300, 5), (1025, 1025)]


def shapes(n_xi: int, n_eta: int) -> list[tuple[int, int]]:
    return [level.grid.shape for level in nested_levels(em.Grid(n_xi=n_xi, n_eta=n_eta))]


def test_square_grids_are_halved() -> None:
    assert shapes(65, 65) == [(9, 9), (17, 17), (33, 33), (65, 65)]
    assert shapes(4, 4) == [(4, 4)]
    assert shapes(9, 9) == [(9, 9)]


def test_grids_that_are_not_square_begin_square() -> None:
    assert shapes(129, 65) == [(9, 9), (17, 17), (33, 33), (65, 65), (129, 65)]
    assert shapes(40, 171) == [(11, 12), (21, 22), (40, 43), (40, 86), (40, 171)]
    assert shapes(5, 300) == [(5, 10), (5, 20), (5, 38), (5, 76), (5, 151), (5, 300)]


@pytest.mark.parametrize("shape", SHAPES)
def test_levels_grow_to_the_grid_at_most_twofold(shape: tuple[int, int]) -> None:
    levels = nested_levels(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    assert levels[-1].grid.shape == shape
    assert [level.is_finest for level in levels] == [False] * (len(levels) - 1) + [True]
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert max(levels[0].grid.shape) <= max(COARSEST_CELLS * 1.5 + 1, 4)
    for coarse, fine in itertools.pairwise(levels):
        for n, m in zip(coarse.grid.shape, fine.grid.shape, strict=True):
            assert n - 1 <= m - 1 <= 2 * (n - 1) + 1
        assert fine.grid.points > coarse.grid.points
        assert fine.steps <= coarse.steps
        assert fine.gauss_points <= coarse.gauss_points
    assert all(level.steps > 0 and level.gauss_points >= 2 for level in levels)


# Of blocks: nodes of a coarse mesh are nodes of the finest one, and edges have one set of nodes.

MAKERS = [l_shape, disc, ring, naca0012_c, pitz_daily]


@pytest.mark.parametrize("make", MAKERS)
def test_every_level_is_a_valid_mesh_of_nodes_of_the_finest(make: Callable[[int], Blocks]) -> None:
    mesh = make(2500).mesh
    levels = block_levels(mesh)
    assert len(levels) > 1
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert np.array_equal(levels[-1].nodes, np.arange(len(mesh.points)))
    for coarse, fine in itertools.pairwise(levels):
        assert coarse.points < 0.6 * fine.points
    for level in levels:
        here = mesh.points[level.nodes]
        assert set(level.cells.ravel().tolist()) == set(range(level.points))
        for block, (rows, columns), nodes in zip(mesh.blocks, level.lines, level.blocks, strict=True):
            assert np.array_equal(level.nodes[nodes], block[np.ix_(rows, columns)])
        corners = here[np.concatenate([quads_of_block(block) for block in level.blocks])]
        one, other = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
        assert (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0] > 0.0).all()


@pytest.mark.parametrize("make", MAKERS)
def test_an_edge_is_found_from_the_block_on_its_other_side(make: Callable[[int], Blocks]) -> None:
    mesh = make(600).mesh
    edges, shared = edges_of(mesh), 0
    for block, nodes in enumerate(mesh.blocks):
        for axis, end in np.ndindex(2, 2):
            other = edges.across(block, axis, end)
            if other is None:
                continue
            shared += 1
            along = nodes[-end] if axis == 0 else nodes[:, -end]
            there = mesh.blocks[other.block]
            row = there[-other.end] if other.axis == 0 else there[:, -other.end]
            assert np.array_equal(row[::-1] if other.is_turned else row, along)
            back = edges.across(other.block, other.axis, other.end)
            assert back is not None
            assert (back.block, back.axis, back.end, back.is_turned) == (block, axis, end, other.is_turned)
    assert shared > 0


def test_steps_and_gauss_points_fall_with_the_points() -> None:
    levels = block_levels(l_shape(20_000).mesh)
    assert [level.steps for level in levels] == sorted((level.steps for level in levels), reverse=True)
    assert [level.gauss_points for level in levels] == sorted((level.gauss_points for level in levels), reverse=True)
    assert [level.is_finest for level in levels] == [False] * (len(levels) - 1) + [True]
