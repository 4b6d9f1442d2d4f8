"""A layer of hexahedra: the plane that it lies in, and the entry of each of its blocks."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_dict import Hex, block_entry, layer_of, vertex_of
from equimesh.io.reading.foam import Word

CUBE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 1], [2, 0, 1], [2, 1, 1], [0, 1, 1]], dtype=float)
NAMES = [*"abcdefgh"]


@pytest.mark.parametrize(("axis", "cells"), [(0, (1, 5, 6)), (1, (5, 1, 6)), (2, (5, 6, 1))])
def test_the_layer_is_where_a_block_has_one_cell(axis: int, cells: tuple[int, int, int]) -> None:
    block = Hex(tuple(range(8)), cells, tuple(range(2, 14)), "", 3)
    layer = layer_of(CUBE, NAMES, 1.0, [block])
    assert layer.axis == axis
    assert layer.lower.sum() == 4
    entry = block_entry(layer, block)
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = (layer.plane(NAMES.index(name)) for name in entry["corners"])
    assert (x2 - x0) * (y3 - y1) - (y2 - y0) * (x3 - x1) > 0
    # Cells and gradings go with the edges between the corners, whichever way the block is turned.
    steps = {frozenset(entry["corners"][:2]), frozenset(entry["corners"][2:])}
    along_i = next(k for k in range(3) if frozenset(_ends(k)[0]) in steps or frozenset(_ends(k)[1]) in steps)
    assert entry["cells"][0] == cells[along_i]
    assert {(ratio - 2) // 4 for ratio in entry["grading"][:2]} == {along_i}


def _ends(axis: int) -> tuple[set[str], set[str]]:
    """The names at the ends of two edges along a local axis, in the lower plane of each possible layer."""
    return {0: ({"a", "b"}, {"e", "f"}), 1: ({"a", "d"}, {"e", "h"}), 2: ({"a", "e"}, {"b", "f"})}[axis]


def test_two_cells_across_are_no_layer() -> None:
    with pytest.raises(InputError, match="line 3: the blocks are no layer of one cell"):
        layer_of(CUBE, NAMES, 1.0, [Hex(tuple(range(8)), (5, 6, 2), (1.0,) * 12, "", 3)])


def test_vertices_have_names_or_numbers() -> None:
    numbers = {"0": 0, "b": 1}
    assert vertex_of(Word("b", 1), numbers) == 1
    assert vertex_of(Word("1", 1), numbers) == 1
    with pytest.raises(InputError, match="line 9: vertex 2 is none of the 2 vertices"):
        vertex_of(Word("2", 9), numbers)
