"""The layout of blocks that are given as arrays of nodes: which edges and vertices they have in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from equimesh.blocks.layout import Layout, line_of
from equimesh.numerics.types import IntArray


def layout_of(blocks: Sequence[IntArray]) -> tuple[Layout, IntArray]:
    """The layout of ``blocks`` of nodes, shape ``(n_i, n_j)`` each, which share whole edges; the node of each vertex.

    Edges and vertices are numbered in the order of the nodes at their ends.
    """
    ends, lengths = np.empty((len(blocks), 4, 4), np.int64), np.empty((len(blocks), 4), np.int64)
    for b, block in enumerate(blocks):
        for side in range(4):
            line = line_of(block, side)
            ends[b, side] = line[0], line[1], line[-2], line[-1]
            lengths[b, side] = len(line) - 1
    rows = ends.reshape(-1, 4)
    # An edge is known by its first step from the lower of its ends; a closed one by the lower of both steps.
    forward = (rows[:, 0] < rows[:, 3]) | ((rows[:, 0] == rows[:, 3]) & (rows[:, 1] <= rows[:, 2]))
    ahead = np.where(forward[:, None], rows, rows[:, ::-1])
    _, first, edge = np.unique(ahead[:, :2], axis=0, return_index=True, return_inverse=True)
    nodes, vertex = np.unique(ahead[first][:, [0, 3]], return_inverse=True)
    layout = Layout(
        edges=vertex.reshape(-1, 2).astype(np.int64),
        block_edges=edge.reshape(-1, 4).astype(np.int64),
        forward=forward.reshape(-1, 4),
        edge_counts=lengths.ravel()[first],
    )
    return layout, nodes
