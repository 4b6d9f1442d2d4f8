"""Rows cut into strips, and strips shared out among parts."""

from __future__ import annotations

import pytest

from equimesh.meshes.parts import MIN_SHARED_NODES, MIN_STRIP_ROWS, STRIP_NODES, Parts


@pytest.mark.parametrize("threads", [1, 2, 3, 7, 64])
@pytest.mark.parametrize("shape", [(1025, 1025), (257, 300), (129, 190), (70, 4000), (16384, 5)])
def test_every_row_belongs_to_one_part_and_every_strip_too(shape: tuple[int, int], threads: int) -> None:
    parts = Parts.of(shape, threads)
    assert len(parts.parts) == min(threads, len(parts.strips))
    assert [row for part in parts.parts for row in range(*part.ends)] == list(range(shape[0]))
    assert [k for part in parts.parts for k in part.strips] == list(range(len(parts.strips)))
    assert [row for first, last in parts.strips for row in range(first, last)] == list(range(1, shape[0] - 1))
    for part in parts.parts:
        within = [row for k in part.strips for row in range(*parts.strips[k])]
        assert set(within) <= set(range(*part.ends)), "a strip lies in its part"


def test_strips_depend_on_the_grid_alone() -> None:
    assert len({Parts.of((700, 513), threads).strips for threads in (1, 2, 3)}) == 1
    heights = [last - first for first, last in Parts.of((1025, 1025)).strips]
    assert max(heights) * 1025 >= STRIP_NODES > (max(heights) - 1) * 1025
    assert max(last - first for first, last in Parts.of((100, 100_000)).strips) == MIN_STRIP_ROWS


def test_small_grids_are_not_shared() -> None:
    assert Parts.of((127, 127), 8).communicator.size == 1
    assert MIN_SHARED_NODES > 127 * 127
    assert [part.ends for part in Parts.of((2, 2)).parts] == [(0, 2)], "two rows have no row between them"


def test_parts_are_equal_in_size_and_answer_in_the_order_of_the_rows() -> None:
    parts = Parts.of((1025, 1025), 2)
    rows = parts.each(lambda part: part.last - part.first)
    assert abs(rows[0] - rows[1]) <= 33
    assert parts.each(lambda part: part.first) == [0, rows[0]]
    assert parts.largest(lambda part: float(part.last)) == 1025.0
    assert parts.smallest(lambda part: float(part.last)) == float(rows[0])
    assert parts.parts[0].rows_and_next == slice(0, rows[0] + 1)
