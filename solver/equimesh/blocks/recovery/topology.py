"""The layout of blocks that are given as arrays of nodes: which edges and vertices they have in common."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from equimesh.blocks.layout import Layout
from equimesh.numerics.types import IntArray


def layout_of(blocks: Sequence[IntArray]) -> tuple[Layout, IntArray]:
    """The layout of ``blocks`` of nodes, shape ``(n_i, n_j)`` each, which share whole edges; the node of each vertex.

    Edges and vertices are numbered in the order of the nodes at their ends.
    """
    flat = np.concatenate([block.reshape(-1) for block in blocks])
    n_i, n_j = np.array([block.shape for block in blocks]).T
    starts = np.cumsum(n_i * n_j) - n_i * n_j
    along_i, along_j = (np.stack([0 * n, 0 * n + 1, n - 2, n - 1], axis=1) for n in (n_i, n_j))
    upright, level = starts[:, None] + along_j, starts[:, None] + along_i * n_j[:, None]
    lines = [upright, upright + ((n_i - 1) * n_j)[:, None], level, level + (n_j - 1)[:, None]]
    ends, lengths = flat[np.stack(lines, axis=1)], np.stack([n_j, n_j, n_i, n_i], axis=1) - 1
    rows = ends.reshape(-1, 4)
    # An edge is known by its first step from the lower of its ends; a closed one by the lower of both steps.
    forward = (rows[:, 0] < rows[:, 3]) | ((rows[:, 0] == rows[:, 3]) & (rows[:, 1] <= rows[:, 2]))
    ahead = np.where(forward[:, None], rows, rows[:, ::-1])
    step = ahead[:, 0] * (int(flat.max()) + 1) + ahead[:, 1]
    _, first, edge = np.unique(step, return_index=True, return_inverse=True)
    nodes, vertex = np.unique(ahead[first][:, [0, 3]], return_inverse=True)
    layout = Layout(
        edges=vertex.reshape(-1, 2).astype(np.int64),
        block_edges=edge.reshape(-1, 4).astype(np.int64),
        forward=forward.reshape(-1, 4),
        edge_counts=lengths.ravel()[first],
    )
    return layout, nodes
