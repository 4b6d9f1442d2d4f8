"""Edges of a mesh, every one once."""

from __future__ import annotations

import numpy as np

from equimesh_coupling import MeshParts
from equimesh_coupling.recovery import edge_numbers, unique_edges


def test_every_edge_is_there_once(parts: MeshParts) -> None:
    edges, of_cells = unique_edges(parts.cells)
    assert len(parts.points) - len(edges) + len(parts.cells) == 1  # Euler's formula
    assert len({frozenset(edge) for edge in edges.tolist()}) == len(edges)
    ahead = np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=2)
    assert np.array_equal(np.sort(edges[of_cells], axis=2), np.sort(ahead, axis=2))
    inner = np.bincount(of_cells.ravel())
    assert set(inner) == {1, 2}
    assert (inner == 1).sum() == sum(map(len, parts.sides.values()))


def test_an_edge_is_found_in_either_direction(parts: MeshParts) -> None:
    edges, _ = unique_edges(parts.cells)
    wanted = np.array([5, 0, 17])
    assert edge_numbers(edges[wanted], edges).tolist() == [5, 0, 17]
    assert edge_numbers(edges[wanted][:, ::-1], edges).tolist() == [5, 0, 17]
