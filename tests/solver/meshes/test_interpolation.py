"""Values on a finer grid by one-dimensional rules: exact for cubics, written or compared."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.nested import extrapolate, interpolate, interpolated_values, rule, rules


def nodes(*points: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(*(np.linspace(0.0, 1.0, n) for n in points), indexing="ij")
    return x, y


@pytest.mark.parametrize("fine", [(13, 21), (9, 30)], ids=["doubled", "other"])
def test_rules_are_exact_for_cubics_and_for_lines(fine: tuple[int, int]) -> None:
    def cubic(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return (x**3 - x) * (2 * y**3 + y**2 - 1)

    (x, y), (fine_x, fine_y) = nodes(7, 11), nodes(*fine)
    assert abs(interpolated_values(cubic(x, y), fine) - cubic(fine_x, fine_y)).max() < 1e-14
    assert abs(interpolated_values(x - 2 * y, fine, cubic=False) - (fine_x - 2 * fine_y)).max() < 1e-14
    curved = interpolated_values(cubic(x, y), fine, cubic=False) - cubic(fine_x, fine_y)
    assert abs(curved).max() > 1e-3, "lines are no cubics"


def test_common_points_keep_their_values_to_the_last_bit() -> None:
    values = np.random.default_rng(0).random((8, 9))
    assert np.array_equal(interpolated_values(values, (15, 17))[::2, ::2], values)


def test_rules_have_weights_that_sum_to_one() -> None:
    for cubic in (True, False):
        found = rule(6, 23, cubic=cubic)
        assert found.weights.sum(axis=0) == pytest.approx(np.ones(23), abs=1e-14)
        assert found.first.max() == 2
        assert not found.weights.flags.writeable, "rules are shared"


def test_rows_are_written_or_compared() -> None:
    coarse, fine = np.random.default_rng(1).random((5, 6)), np.full((9, 11), 7.0)
    along = rules(coarse.shape, fine.shape)
    whole = interpolated_values(coarse, fine.shape)
    assert interpolate(coarse, *along, (0, 9), fine, False) == abs(whole - 7.0).max()
    assert (fine == 7.0).all()
    interpolate(coarse, *along, (3, 8), fine, True)
    assert np.array_equal(fine[3:8], whole[3:8])
    assert (fine[:3] == 7.0).all()
    assert (fine[8] == 7.0).all()
    fine[4, 4] = np.nan
    assert np.isnan(interpolate(coarse, *along, (3, 8), fine, False)), "a hole must not be overlooked"


def test_extrapolation_continues_the_difference() -> None:
    values, before = np.random.default_rng(2).random((2, 6, 4))
    expected = values + 0.25 * (values - before)
    found = before.copy()
    extrapolate(values, found, 0.25, (2, 5))
    assert np.array_equal(found[2:5], expected[2:5])
    assert np.array_equal(found[:2], before[:2])
    assert np.array_equal(found[5:], before[5:])
