"""What a part may hold: names, shapes, blocks, and the sides of its nodes."""

from __future__ import annotations

import numpy as np
import pytest

from cluster_package.part_files.parted import CUTS, DATA, N_ETA, parts_of
from equimesh.errors import InputError
from equimesh.io.write import node_groups
from equimesh_cluster import PartData
from equimesh_cluster.part_files.formats import BLOCK_NUMBERS, blocks, corners, node_block, side_digits


def test_names_and_shapes_are_checked() -> None:
    part = parts_of(CUTS[1])[0]
    rows, columns = part.x.shape
    for data, reason in (
        (PartData(nodes={"x": part.x}), "there is an array 'x' already"),
        (PartData(nodes={"u": part.x}, cells={"u": part.x[1:, 1:]}), "there is an array 'u' already"),
        (PartData(nodes={"a/b": part.x}), "cannot be the name of an array"),
        (PartData(nodes={"é": part.x}), "cannot be the name of an array"),
        (
            PartData(nodes={"u": part.x[1:]}),
            rf"u has shape \({rows - 1}, {columns}\): part 0 needs \({rows}, {columns}\)",
        ),
        (PartData(cells={"q": part.x}), f"part 0 needs .{rows - 1}, {columns - 1}"),
    ):
        with pytest.raises(InputError, match=reason):
            data.check(part)
    PartData(nodes={"u": part.x}, cells={"q": part.x[1:, 1:]}).check(part)


def test_blocks_cover_everything_once() -> None:
    found = [*blocks(1000, 1025)]
    assert [row for some in found for row in range(some.start, some.stop)] == [*range(1000)]
    assert max(some.stop - some.start for some in found) == BLOCK_NUMBERS // 1025
    assert [*blocks(2, 10 * BLOCK_NUMBERS)] == [slice(0, 1), slice(1, 2)]
    assert [*blocks(0, 5)] == []


def test_functions_are_evaluated_at_the_block() -> None:
    part = parts_of(CUTS[1])[1]
    block = slice(2, 5), slice(3, 7)
    np.testing.assert_array_equal(node_block(lambda x, y: x - y, part, *block), (part.x - part.y)[block])
    assert node_block(lambda *_: np.float64(3), part, *block).shape == (3, 4)


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_sides_are_those_of_the_whole_mesh(cuts: tuple[int, ...]) -> None:
    expected = node_groups(DATA).reshape(DATA.mesh.x.shape)
    for part in parts_of(cuts):
        found = side_digits(part, slice(0, part.x.shape[0]))
        np.testing.assert_array_equal(found, expected[part.first : part.first + part.x.shape[0]])
        np.testing.assert_array_equal(side_digits(part, slice(3, 5)), found[3:5])


def test_corners_are_counter_clockwise() -> None:
    assert corners(1, 2, N_ETA, np.int32)[0].tolist() == [N_ETA, 2 * N_ETA, 2 * N_ETA + 1, N_ETA + 1]
    assert corners(0, 0, N_ETA, np.int64).shape == (0, 4)
