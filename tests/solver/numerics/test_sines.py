"""The fast solver solves what it says, checked by applying the second differences."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.numerics.newton import solve_by_sines, solve_lines
from equimesh.numerics.types import Array


def second_difference(p: Array, axis: int) -> Array:
    padded = np.pad(p, [(1, 1) if k == axis else (0, 0) for k in range(2)])
    return np.diff(padded, 2, axis=axis)


@pytest.mark.parametrize("shape", [(5, 5), (7, 12), (1, 3), (31, 2)])
def test_the_elliptic_equation_is_solved(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    across, right = rng.uniform(0.0, 3.0, shape[0]), rng.standard_normal(shape)
    p = solve_by_sines(2.0, across, right.copy())
    assert 2.0 * second_difference(p, 0) + across[:, None] * second_difference(p, 1) == pytest.approx(right, abs=1e-12)


def test_every_line_by_itself() -> None:
    right = np.random.default_rng(3).standard_normal((9, 4))
    before = right.copy()
    assert 5.0 * second_difference(solve_lines(5.0, right), 0) == pytest.approx(right, abs=1e-12)
    assert (right == before).all(), "the right side is kept"
