"""The edges of a mesh: every one once, and the place of given ones among them."""

from __future__ import annotations

import numpy as np

from equimesh_coupling.parts import IntArray


def unique_edges(cells: IntArray) -> tuple[IntArray, IntArray]:
    """Every edge of ``cells`` once, shape ``(k, 2)``, and the number of each edge of each cell, shape of ``cells``.

    Edge ``j`` of a cell leads from its corner ``j`` to the next. The direction of an edge is that in its first cell.
    """
    ends = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    _, first, number = np.unique(_keys(ends), return_index=True, return_inverse=True)
    return ends[first], number.reshape(cells.shape)


def edge_numbers(wanted: IntArray, edges: IntArray) -> IntArray:
    """The places of the ``wanted`` edges, shape ``(k, 2)``, among ``edges``, in either direction."""
    keys = _keys(edges)
    order = np.argsort(keys)
    found: IntArray = order[np.searchsorted(keys, _keys(wanted), sorter=order)]
    return found


def _keys(edges: IntArray) -> IntArray:
    """One number for each edge, the same in both directions; it holds up to 2**31 nodes."""
    ends = np.sort(np.asarray(edges, dtype=np.int64), axis=1)
    keys: IntArray = ends[:, 0] << 32 | ends[:, 1]
    return keys
