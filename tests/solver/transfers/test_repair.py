"""Bounds and an integral at once."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.transfers.repair import give_to_neighbours, repair, share_out


def test_what_is_beyond_a_bound_moves_to_neighbours() -> None:
    rng = np.random.default_rng(5)
    weights, values = rng.uniform(0.5, 2.0, (12, 9)), rng.uniform(-0.2, 1.2, (12, 9))
    lowest, highest = np.zeros((12, 9)), np.ones((12, 9))
    before = np.sum(weights * values)
    repair(values, weights, lowest, highest)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.sum(weights * values) == pytest.approx(before, abs=1e-13)


def test_values_far_away_do_not_change() -> None:
    values = np.full((11, 11), 0.5)
    values[5, 5] = 1.3
    give_to_neighbours(values, np.ones((11, 11)), np.zeros((11, 11)), np.ones((11, 11)), 1)
    assert values[5, 5] == 1.0
    assert np.count_nonzero(values != 0.5) == 9
    assert values.sum() == pytest.approx(0.5 * 120 + 1.3)
    assert not give_to_neighbours(values, np.ones((11, 11)), np.zeros((11, 11)), np.ones((11, 11)), 1)


def test_values_within_bounds_stay() -> None:
    values = np.linspace(0.0, 1.0, 20).reshape(4, 5)
    same = values.copy()
    repair(values, np.ones((4, 5)), np.zeros((4, 5)), np.ones((4, 5)))
    assert np.array_equal(values, same)


@pytest.mark.parametrize(("aim", "reached"), [(6.0, 6.0), (1.0, 1.0), (50.0, 10.0), (-3.0, 0.0)])
def test_a_sum_is_reached_as_far_as_bounds_allow(aim: float, reached: float) -> None:
    values = np.linspace(0.0, 1.0, 10)
    share_out(values, np.ones(10), np.zeros(10), np.ones(10), aim)
    assert values.sum() == pytest.approx(reached, abs=1e-13)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
