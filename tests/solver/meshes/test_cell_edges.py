"""The edges of quadrilaterals: their two cells, sides, and periodic joins."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import channel, in_blocks, l_shape
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import NO_CELL, CellEdges, originals_of
from equimesh.meshes.mesh import Mesh
from solver.quality.handmade import wavy


def edges_of(mesh: Mesh) -> CellEdges:
    return CellEdges.of(mesh.cells, len(mesh.points), mesh.ties)


def test_every_edge_is_found_once_with_the_cells_on_both_sides() -> None:
    mesh = in_blocks(wavy()).mesh
    found = edges_of(mesh)
    assert len(found.cells) == 12 * 9 + 13 * 8
    for k, (cells, places) in enumerate(zip(found.cells, found.places, strict=True)):
        pairs = {
            frozenset((mesh.cells[cell, place], mesh.cells[cell, (place + 1) % 4]))
            for cell, place in zip(cells.tolist(), places.tolist(), strict=True)
            if cell != NO_CELL
        }
        assert len(pairs) == 1
        for cell, place in zip(cells.tolist(), places.tolist(), strict=True):
            assert cell == NO_CELL or found.of_cells[cell, place] == k
    assert found.is_outer.sum() == 2 * 12 + 2 * 8


def test_the_outer_edges_are_those_of_the_sides_and_neighbours_see_each_other() -> None:
    mesh = l_shape()
    found = edges_of(mesh)
    outer = np.flatnonzero(found.is_outer)
    first, place = found.cells[outer, 0], found.places[outer, 0]
    ends = np.column_stack([mesh.cells[first, place], mesh.cells[first, (place + 1) % 4]])
    assert {*map(tuple, ends.tolist())} == {*map(tuple, np.concatenate([*mesh.sides.values()]).tolist())}
    around = found.neighbours
    for cell, others in enumerate(around.tolist()):
        assert all(other == NO_CELL or cell in around[other] for other in others)
    assert (around == NO_CELL).sum() == len(outer)


def test_joined_sides_are_inner_edges() -> None:
    mesh = channel(5)
    assert edges_of(mesh).is_outer.sum() == 2 * 9
    assert originals_of(4, np.array([[3, 2], [2, 0]])) == pytest.approx([0, 1, 0, 0])
    assert originals_of(4, None).tolist() == originals_of(4, np.empty((0, 2), dtype=np.int64)).tolist() == [0, 1, 2, 3]


def test_an_edge_with_three_cells_is_refused() -> None:
    cells = np.array([[0, 1, 2, 3], [1, 0, 4, 5], [0, 1, 6, 7]])
    with pytest.raises(InputError, match="the edge from node 0 to node 1 has more than two cells, one of them cell 2"):
        CellEdges.of(cells, 8)
