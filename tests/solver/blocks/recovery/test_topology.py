"""The layout of blocks that are arrays of nodes."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.layout import line_of
from equimesh.blocks.recovery.half_edges import HalfEdges, blocks_of
from equimesh.blocks.recovery.recovered import layout_of
from solver.blocks.recovery.meshes import Arrays, disc, grid, ring, without

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
