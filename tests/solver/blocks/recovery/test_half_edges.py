"""Half-edges: which cells meet, and what is said of meshes whose cells do not meet well."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from equimesh.blocks.layout import line_of
from equimesh.blocks.recovery.half_edges import HalfEdges, blocks_of, counter_clockwise
from equimesh.blocks.recovery.recovered import layout_of
from equimesh.errors import InputError
from equimesh.meshes.mesh import quads_of_block
from equimesh.numerics.types import IntArray
from solver.blocks.recovery.meshes import Arrays, boundary_of, disc, grid, ring, without


def test_twins_degrees_and_irregular_nodes() -> None:
    points, cells = disc(3)
    edges = HalfEdges.of(points, cells)
    inner = np.flatnonzero(edges.twin >= 0)
    np.testing.assert_array_equal(edges.twin[edges.twin[inner]], inner)
    start, end = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    np.testing.assert_array_equal(start[edges.twin[inner]], end[inner])
    assert edges.degree[edges.irregular].tolist() == [3, 3, 3, 3]
    np.testing.assert_allclose(np.abs(points[edges.irregular]), 0.5)
    assert edges.boundary.sum() == 12
    np.testing.assert_array_equal(np.sort(np.unique(boundary_of((points, cells)))), np.flatnonzero(edges.boundary))


def test_closed_lines_have_the_domain_on_their_left() -> None:
    points, cells = ring(8, 3)
    loops = HalfEdges.of(points, cells).loops()
    assert [len(loop) for loop in loops] == [8, 8]
    areas = []
    for loop in loops:
        x, y = points[loop].T
        areas.append(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert sorted(np.sign(areas)) == [-1, 1]


def test_clockwise_cells_are_turned_and_keep_their_first_node() -> None:
    points, cells = grid(2, 2)
    mixed = cells.copy()
    mixed[1] = mixed[1, [0, 3, 2, 1]]
    np.testing.assert_array_equal(counter_clockwise(points, mixed), cells)
    assert counter_clockwise(points, cells) is cells


def refused(points: np.ndarray, cells: np.ndarray) -> str:
    with pytest.raises(InputError) as caught:
        HalfEdges.of(points, cells)
    return caught.value.message


def test_a_folded_cell_is_named_with_its_place() -> None:
    points, cells = grid(3, 3)
    points = points.copy()
    points[5] = [0.7, 0.7]
    assert "is folded or flat at node" in refused(points, cells)
    flat = grid(1, 1)[0].copy()
    flat[3] = [0.5, 0.5]
    assert (
        "cell 0, with the nodes [0, 2, 3, 1] near (0.375, 0.375), is folded or flat at node 3 at (0.5, 0.5)"
        in refused(flat, grid(1, 1)[1])
    )


def test_cells_on_the_same_side_of_an_edge_are_named() -> None:
    points, cells = grid(2, 1)
    more = np.concatenate([points, [[0.2, 0.9], [0.2, 0.1]]])
    message = refused(more, np.concatenate([cells[:1], [[2, 3, 6, 7]]]))
    assert message.startswith("the cells 0 and 1 lie on the same side of the edge between the nodes 2 and 3")


def test_an_edge_of_three_cells_is_named() -> None:
    points, cells = grid(2, 1)
    more = np.concatenate([points, [[0.4, 0.0], [0.4, 1.0]]])
    message = refused(more, np.concatenate([cells, [[6, 2, 3, 7]]]))
    assert "the edge between the nodes 2 and 3 near (0.5, 0.5) belongs to more than two cells" in message


def test_a_domain_that_touches_itself_and_one_of_two_pieces() -> None:
    points, cells = grid(2, 2)
    assert "the domain touches itself at node 4 at (0.5, 0.5)" in refused(points[:], cells[[0, 3]])
    points, cells = without(grid(5, 1), (0.4, 0.6, 0, 1))
    message = refused(points, cells)
    assert (
        "several pieces: cell 2, with the nodes [6, 8, 9, 7] near (0.7, 0.5), is not connected with cell 0" in message
    )


# The layout of blocks that are arrays of nodes.


MESHES = {
    "grid": (grid(3, 2), 4, 4),
    "cell": (grid(1, 1), 4, 4),
    "L": (without(grid(4, 4), (0.5, 1, 0.5, 1)), 8, 10),
    "disc": (disc(2), 8, 12),
    "ring": (ring(7, 2), 2, 3),
    "ring of three cells": (ring(3, 1), 2, 3),
}


@pytest.mark.parametrize("name", MESHES)
def test_edges_and_vertices_are_counted_once_and_lines_follow_them(name: str) -> None:
    mesh, vertices, edges = MESHES[name]
    layout, nodes, blocks = found(mesh)
    assert (layout.vertex_count, len(layout.edges)) == (vertices, edges)
    lines = layout.edge_nodes(tuple(blocks))
    for b, block in enumerate(blocks):
        for side in range(4):
            edge, line = layout.block_edges[b, side], line_of(block, side)
            np.testing.assert_array_equal(lines[edge], line[:: 1 if layout.forward[b, side] else -1])
            np.testing.assert_array_equal(nodes[layout.edges[edge]], lines[edge][[0, -1]])
    assert layout.node_count == len(mesh[0])
    assert layout.shapes == tuple(block.shape for block in blocks)


def found(mesh: Arrays):
    points, cells = mesh
    edges = HalfEdges.of(points, cells)
    corners = np.zeros(len(points), np.bool_)
    blocks, _ = blocks_of(edges, corners)
    return *layout_of(blocks), blocks


def test_an_interface_is_one_edge_of_two_blocks() -> None:
    layout, _, _ = found(MESHES["disc"][0])
    assert sorted(layout.edge_uses.tolist()) == [1] * 4 + [2] * 8
    assert len(layout.boundary) == 4
    assert len(layout.counts) == 3


# Blocks by lines from irregular nodes: which there are, and that each node and cell is where it belongs.


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
