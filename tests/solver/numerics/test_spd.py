"""Symmetric 2 x 2 matrices: powers and intersections, against their eigenvalues."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from equimesh.numerics import spd
from solver.monitors.metrics import matrices, triple

numbers = st.floats(-3.0, 3.0)


properties = settings(deadline=None)  # the first example compiles


@properties
@given(st.floats(0.0, math.pi), numbers, numbers, st.floats(-2.0, 2.0))
def test_a_power_has_the_powers_of_the_eigenvalues(angle: float, p: float, q: float, exponent: float) -> None:
    got = matrices(spd.power(triple(angle, 10**p, 10**q), exponent))
    expected = matrices(triple(angle, 10 ** (p * exponent), 10 ** (q * exponent)))
    assert got == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


@properties
@given(*[st.floats(0.0, math.pi), numbers, numbers] * 2)
def test_an_intersection_dominates_both_and_does_not_mind_the_order(
    angle: float, p: float, q: float, other_angle: float, r: float, s: float
) -> None:
    first, second = triple(angle, 10**p, 10**q), triple(other_angle, 10**r, 10**s)
    both = matrices(spd.intersection(first, second))
    size = np.abs(both).max()
    for one in (first, second):
        assert np.linalg.eigvalsh(both - matrices(one)).min() > -1e-12 * size
    assert matrices(spd.intersection(second, first)) == pytest.approx(both, abs=1e-9 * size)
    # and not more than that: in the basis in which both are diagonal it is the larger of each pair
    lower = np.linalg.cholesky(matrices(first)[0])
    inverse = np.linalg.inv(lower)
    size, basis = np.linalg.eigh(inverse @ matrices(second)[0] @ inverse.T)
    exact = lower @ basis @ np.diag(np.maximum(size, 1.0)) @ basis.T @ lower.T
    assert both[0] == pytest.approx(exact, abs=0.006 * np.abs(exact).max())


def test_an_intersection_with_a_much_smaller_metric_changes_nothing() -> None:
    large, small = triple(0.3, 7.0, 2.0), triple(1.1, 1e-3, 1e-4)
    assert matrices(spd.intersection(large, small)) == pytest.approx(matrices(large), rel=1e-4)
