"""Coarser meshes of blocks: their nodes are nodes of the finest mesh, and edges have one set of nodes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.least_error.block_levels import block_levels, edges_of
from equimesh.meshes.mesh import quads_of_block
from equimesh.testing.geometries import disc, l_shape, naca0012_c, pitz_daily, ring

MAKERS = [l_shape, disc, ring, naca0012_c, pitz_daily]


@pytest.mark.parametrize("make", MAKERS)
def test_every_level_is_a_valid_mesh_of_nodes_of_the_finest(make: Callable[[int], Blocks]) -> None:
    mesh = make(2500).mesh
    levels = block_levels(mesh)
    assert len(levels) > 1
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert np.array_equal(levels[-1].nodes, np.arange(len(mesh.points)))
    for coarse, fine in pairwise(levels):
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
