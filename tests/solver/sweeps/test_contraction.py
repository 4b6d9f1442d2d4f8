"""The error that moves leave which shrink by a factor each."""

from __future__ import annotations

import math

import pytest

from equimesh.sweeps.sweep import error_left


@pytest.mark.parametrize("contraction", [0.0, 0.1, 0.5, 0.9])
def test_it_is_the_sum_of_the_moves_to_come(contraction: float) -> None:
    moves = [3.0 * contraction**k for k in range(1, 1000)]
    assert error_left(3.0, contraction) == pytest.approx(sum(moves), abs=1e-12)


@pytest.mark.parametrize("contraction", [1.0, 1.5])
def test_moves_that_do_not_shrink_leave_an_error_without_bound(contraction: float) -> None:
    assert error_left(1e-9, contraction) == math.inf
    assert error_left(0.0, contraction) == 0.0
