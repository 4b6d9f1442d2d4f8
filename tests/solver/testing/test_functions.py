"""Taylor remainders: exact slopes pass however steep the function, wrong ones are measured."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.testing.functions import wrong_by

X = np.linspace(-1.0, 1.0, 41)


@pytest.mark.parametrize("k", [0.0, 1.0, 100.0, 3000.0])
def test_an_exact_slope_is_not_wrong(k: float) -> None:
    assert not wrong_by(lambda h: np.tanh(k * (X + h)), k / np.cosh(np.minimum(k * np.abs(X), 300.0)) ** 2).any()


def test_a_kink_next_to_a_point_is_not_blamed_on_the_slope() -> None:
    x = np.array([3e-5, 0.2])
    assert not wrong_by(lambda h: np.abs(x + h), np.sign(x)).any()


def test_an_error_of_the_slope_is_measured() -> None:
    assert wrong_by(lambda h: np.sin(X + h), np.cos(X) + 1e-3) == pytest.approx(np.full(X.size, 1e-3), rel=1e-3)
