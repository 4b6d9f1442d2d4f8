"""Cells that grow along an edge."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.grading import grading_of, is_same, reversed_grading, shares


def test_cells_grow_by_one_factor_up_to_the_ratio() -> None:
    cells = np.diff(shares(grading_of(8, "g"), 4))
    assert cells[1:] / cells[:-1] == pytest.approx([2.0, 2.0, 2.0])
    assert cells[-1] / cells[0] == pytest.approx(8.0)
    assert shares(grading_of(1, "g"), 4).tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_sections_share_length_and_cells() -> None:
    places = shares(grading_of([[1, 3, 1], [3, 1, 1]], "g"), 8)
    assert places == pytest.approx([*np.linspace(0, 0.25, 7), 0.625, 1.0])
    assert shares(grading_of([[1, 1, 2], [1, 1, 2]], "g"), 1).tolist() == [0.0, 1.0]
    assert len(shares(grading_of([[1, 9, 2], [1, 0.001, 2]], "g"), 3)) == 4


def test_a_reversed_grading_gives_the_same_nodes_from_the_other_end() -> None:
    grading = grading_of([[1, 1, 4], [2, 1, 0.5]], "g")
    assert 1 - shares(reversed_grading(grading), 10)[::-1] == pytest.approx(shares(grading, 10))
    assert is_same(reversed_grading(reversed_grading(grading)), grading)
    assert not is_same(reversed_grading(grading), grading)


@pytest.mark.parametrize("value", [0, -1, "2", None, True, [], [[1, 2]], [[1, 1, 0]], [3, 4], 1e7])
def test_other_gradings_are_refused(value: object) -> None:
    with pytest.raises(em.InputError, match=r"blocks\[0\]\.grading") as caught:
        grading_of(value, "domain.blocks[0].grading")
    assert caught.value.field.startswith("domain.blocks[0].grading")
