"""Blocks by lines from irregular nodes: which there are, and that each node and cell is where it belongs."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from equimesh.blocks.recovery.half_edges import HalfEdges, blocks_of
from equimesh.meshes.quad_mesh import quads_of_block
from equimesh.numerics.types import IntArray
from solver.blocks.recovery.meshes import Arrays, disc, grid, ring, without


def blocks(mesh: Arrays, vertices: tuple[int, ...] = ()) -> list[IntArray]:
    points, cells = mesh
    fixed = np.zeros(len(points), np.bool_)
    fixed[list(vertices)] = True
    found, own = blocks_of(HalfEdges.of(points, cells), fixed)
    taken = np.concatenate([part.ravel() for part in own])
    np.testing.assert_array_equal(np.sort(taken), np.arange(len(cells)))
    for block, part in zip(found, own, strict=True):
        assert part.shape == (block.shape[0] - 1, block.shape[1] - 1)
        np.testing.assert_array_equal(np.sort(quads_of_block(block), axis=1), np.sort(cells[part.ravel()], axis=1))
    return found


def test_a_grid_is_one_block_in_its_own_directions() -> None:
    (block,) = blocks(grid(5, 3))
    np.testing.assert_array_equal(block, np.arange(24).reshape(6, 4))


def test_blocks_do_not_depend_on_where_cells_begin_but_for_their_directions() -> None:
    points, cells = grid(5, 3)
    random = np.random.default_rng(2)
    turned = np.array([np.roll(cell, random.integers(4)) for cell in cells])[random.permutation(15)]
    (block,) = blocks((points, turned))
    assert sorted(block.shape) == [4, 6]
    assert sorted([block[0, 0], block[0, -1], block[-1, 0], block[-1, -1]]) == [0, 3, 20, 23]


@pytest.mark.parametrize(
    ("mesh", "count"),
    [
        (without(grid(4, 4), (0.5, 1, 0.5, 1)), 3),  # an L
        (without(grid(6, 6), (0.3, 0.7, 0.3, 0.7)), 8),  # a hole
        (disc(3), 5),
    ],
)
def test_lines_from_irregular_nodes_cut_the_mesh(mesh: Arrays, count: int) -> None:
    assert len(blocks(mesh)) == count


def test_a_corner_of_two_cells_cuts_where_it_is_named() -> None:
    assert len(blocks(grid(6, 4))) == 1
    assert [block.shape for block in blocks(grid(6, 4), (10,))] == [(3, 5), (5, 5)]


def test_a_ring_is_one_block_that_closes_at_its_first_cell() -> None:
    (block,) = blocks(ring(9, 2))
    assert block.shape in {(3, 10), (10, 3)}
    around = block if block.shape == (10, 3) else block.T
    np.testing.assert_array_equal(around[0], around[-1])
    assert sorted(around[0].tolist()) == [0, 1, 2]


def test_a_ring_in_a_ring_is_cut_once() -> None:
    """A node of two cells of the inner side that is a corner makes a line, which is the cut of both."""
    (block,) = blocks(ring(9, 4), (20,))
    around = block if block.shape == (10, 5) else block.T
    assert 20 in around[0]
    np.testing.assert_array_equal(around[0], around[-1])


def test_every_edge_of_a_block_is_whole_one_of_its_neighbour() -> None:
    found = blocks(without(grid(9, 7), (0.4, 0.6, 0.2, 0.6)))
    lines = [line for block in found for line in (block[0], block[-1], block[:, 0], block[:, -1])]
    keys = [min(tuple(line.tolist()), tuple(line[::-1].tolist())) for line in lines]
    steps: dict[tuple[int, int], set[tuple[int, ...]]] = {}
    for key in keys:
        for a, b in itertools.pairwise(key):
            steps.setdefault((min(a, b), max(a, b)), set()).add(key)
    assert all(len(users) == 1 for users in steps.values())
