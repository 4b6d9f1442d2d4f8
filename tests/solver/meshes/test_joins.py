"""Pairs of joined sides, from the nodes that are tied."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.meshes.cell_edges import joins_of
from equimesh.meshes.mesh import Grid, Mesh

SQUARE = Mesh.uniform(Grid(n_xi=5, n_eta=4))
NUMBER = np.arange(20).reshape(5, 4)
ACROSS = np.column_stack([NUMBER[-1], NUMBER[0]])
UP = np.column_stack([NUMBER[:, -1], NUMBER[:, 0]])


def test_the_copy_has_the_edges_of_its_original() -> None:
    (join,) = joins_of(SQUARE.points, SQUARE.sides, ACROSS)
    assert (join.original, join.copy) == ("left", "right")
    assert np.array_equal(join.edges - 16, SQUARE.sides["left"])
    assert join.translation.tolist() == [1.0, 0.0]
    assert sorted(map(tuple, join.nodes)) == sorted(map(tuple, ACROSS))
    (other,) = joins_of(SQUARE.points, SQUARE.sides, ACROSS[:, ::-1])
    assert (other.original, other.copy) == ("right", "left")
    assert other.translation.tolist() == [-1.0, 0.0]


def test_both_directions_may_be_joined() -> None:
    one, two = joins_of(SQUARE.points, SQUARE.sides, np.concatenate([ACROSS, UP[:-1]]))
    assert {(one.original, one.copy), (two.original, two.copy)} == {("left", "right"), ("bottom", "top")}
    assert np.array_equal(two.edges - 3, SQUARE.sides[two.original])


def test_no_ties_no_joins() -> None:
    assert joins_of(SQUARE.points, SQUARE.sides, ACROSS[:0]) == ()


def test_sides_that_are_joined_in_part_are_refused() -> None:
    with pytest.raises(InputError, match="the side left is joined in part, to several sides, or to itself"):
        joins_of(SQUARE.points, SQUARE.sides, ACROSS[:3])
    ends = {"ends": np.concatenate([SQUARE.sides["left"], SQUARE.sides["right"]])}
    with pytest.raises(InputError, match="the side ends is joined in part, to several sides, or to itself"):
        joins_of(SQUARE.points, ends, ACROSS)
