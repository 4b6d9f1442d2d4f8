"""Extremes of a function that do not depend on where closed lines begin."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors.metrics import extremes


@pytest.mark.parametrize("shift", [0.0, 0.1234, 1 / 3])
def test_extremes_between_nodes_are_found(shift: float) -> None:
    u = em.Expression(f"sin(2*pi*(x+{shift}))*(1.5+cos(2*pi*(y-{shift})))")
    low, high = extremes(u, em.Rectangle(periodic="both"))
    assert high == pytest.approx(2.5, rel=1e-13)
    assert low == pytest.approx(-2.5, rel=1e-13)


def test_sides_are_not_crossed() -> None:
    assert extremes(em.Expression("x*sin(2*pi*y)"), em.Rectangle(periodic="y")) == pytest.approx((-1.0, 1.0), rel=1e-13)


def test_a_function_without_finite_values_has_no_range() -> None:
    class Nowhere:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            return (np.full(np.shape(x + y), np.nan),) * (1 + order)

    assert extremes(Nowhere(), em.Rectangle(periodic="y")) == (0.0, 0.0)
