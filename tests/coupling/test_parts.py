"""The arrays of a mesh for other libraries."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh_coupling import BadValues, MeshParts
from equimesh_coupling.parts import SIDES, TAGS


def doubled_areas(parts: MeshParts) -> np.ndarray:
    """Twice the signed area of each cell, by the shoelace formula."""
    x, y = parts.points[parts.cells, 0], parts.points[parts.cells, 1]
    return (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1)


def test_cells_are_counter_clockwise_and_fill_the_same_area(quads: MeshParts, triangles: MeshParts) -> None:
    assert doubled_areas(quads).min() > 0
    assert doubled_areas(triangles).min() > 0
    assert np.allclose(doubled_areas(triangles).reshape(-1, 2).sum(axis=1), doubled_areas(quads))
    assert not quads.is_triangular
    assert triangles.is_triangular


def test_the_sides_are_edges_of_the_cells_with_the_domain_on_their_left(parts: MeshParts) -> None:
    assert (*parts.sides,) == SIDES == (*TAGS,)
    ahead = np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=2).reshape(-1, 2)
    directed = set(map(tuple, ahead.tolist()))
    number = np.arange(35).reshape(7, 5)
    nodes = {"left": number[0], "right": number[-1], "bottom": number[:, 0], "top": number[:, -1]}
    for side, edges in parts.sides.items():
        assert set(map(tuple, edges.tolist())) <= directed
        assert {*edges.ravel().tolist()} == {*nodes[side].tolist()}
    assert list(TAGS.values()) == [1, 2, 3, 4]


def test_both_kinds_of_cells_are_made_of_each_other(quads: MeshParts, triangles: MeshParts) -> None:
    assert quads.mesh_parts("quad") is quads.mesh_parts() is quads
    assert np.array_equal(quads.mesh_parts("triangle").cells, triangles.cells)
    assert np.array_equal(triangles.mesh_parts("quad").cells, quads.cells)
    with pytest.raises(BadValues, match="unknown kind of cells 'hexagon': choose quad or triangle"):
        quads.mesh_parts("hexagon")  # type: ignore[arg-type]
