"""Levels: from a nearly square coarse grid to the requested one, with more work on coarse grids."""

from __future__ import annotations

import itertools

import pytest

import equimesh as em
from equimesh.least_error.nest import COARSEST_CELLS, nested_levels

SHAPES = [(65, 65), (129, 65), (40, 171), (4, 4), (5, 300), (9, 9), (17, 16), (300, 5), (1025, 1025)]


def shapes(n_xi: int, n_eta: int) -> list[tuple[int, int]]:
    return [level.grid.shape for level in nested_levels(em.Grid(n_xi=n_xi, n_eta=n_eta))]


def test_square_grids_are_halved() -> None:
    assert shapes(65, 65) == [(9, 9), (17, 17), (33, 33), (65, 65)]
    assert shapes(4, 4) == [(4, 4)]
    assert shapes(9, 9) == [(9, 9)]


def test_grids_that_are_not_square_begin_square() -> None:
    assert shapes(129, 65) == [(9, 9), (17, 17), (33, 33), (65, 65), (129, 65)]
    assert shapes(40, 171) == [(11, 12), (21, 22), (40, 43), (40, 86), (40, 171)]
    assert shapes(5, 300) == [(5, 10), (5, 20), (5, 38), (5, 76), (5, 151), (5, 300)]


@pytest.mark.parametrize("shape", SHAPES)
def test_levels_grow_to_the_grid_at_most_twofold(shape: tuple[int, int]) -> None:
    levels = nested_levels(em.Grid(n_xi=shape[0], n_eta=shape[1]))
    assert levels[-1].grid.shape == shape
    assert [level.is_finest for level in levels] == [False] * (len(levels) - 1) + [True]
    assert [level.number for level in levels] == list(range(len(levels)))
    assert {level.count for level in levels} == {len(levels)}
    assert max(levels[0].grid.shape) <= max(COARSEST_CELLS * 1.5 + 1, 4)
    for coarse, fine in itertools.pairwise(levels):
        for n, m in zip(coarse.grid.shape, fine.grid.shape, strict=True):
            assert n - 1 <= m - 1 <= 2 * (n - 1) + 1
        assert fine.grid.points > coarse.grid.points
        assert fine.steps <= coarse.steps
        assert fine.gauss_points <= coarse.gauss_points
    assert all(level.steps > 0 and level.gauss_points >= 2 for level in levels)
