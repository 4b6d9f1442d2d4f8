"""Straight lines, circles, formulas: places, velocities, nearest points."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import Airfoil
from equimesh.blocks.curves import BoundaryCurve, Circle, FormulaCurve, Line, wrapped
from equimesh.blocks.spline_curve import SplineCurve

ANGLES = np.linspace(0, 2 * math.pi, 25)
CURVES = [
    Line(start=(1.0, 2.0), end=(4.0, 6.0)),
    Circle(center=(1.0, -1.0), radius=2.0),
    FormulaCurve(curve=em.Curve.of_expressions("t", "t**2 - t")),
    SplineCurve(points=((0.0, 0.0), (1.0, 0.5), (2.0, 0.0), (3.0, 1.0))),
    SplineCurve(points=tuple((math.cos(a), 2 * math.sin(a)) for a in ANGLES), closed=True),
    Airfoil(digits="0012"),
    Airfoil(digits="4415", chord=2.0, leading_edge=(1.0, 1.0), angle=5.0),
]


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: type(curve).__name__)
def test_velocities_are_the_derivatives_of_places(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.013, 0.987, 23)
    step = 1e-6 * (high - low)
    x, y, x_t, y_t = curve.evaluate(t)
    ahead, behind = curve.evaluate(t + step), curve.evaluate(t - step)
    size = np.hypot(x_t, y_t).max()
    assert np.abs((ahead[0] - behind[0]) / (2 * step) - x_t).max() < 1e-6 * size
    assert np.abs((ahead[1] - behind[1]) / (2 * step) - y_t).max() < 1e-6 * size
    assert x.shape == y.shape == t.shape


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: type(curve).__name__)
def test_points_of_the_curve_are_their_own_nearest_ones(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.02, 0.98, 15)
    x, y, x_t, y_t = curve.evaluate(t)
    assert np.abs(curve.nearest(x, y) - t).max() < 1e-9 * (high - low)
    off = 1e-3 / np.hypot(x_t, y_t)
    assert np.abs(curve.nearest(x - off * y_t, y + off * x_t) - t).max() < 1e-6 * (high - low)


@pytest.mark.parametrize("curve", [c for c in CURVES if c.closed], ids=lambda curve: type(curve).__name__)
def test_closed_curves_repeat(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.1, 0.9, 7)
    for turns in (-2, 1):
        again = t + turns * (high - low)
        assert np.abs(wrapped(curve, again) - t).max() < 1e-12
        assert curve.evaluate(again)[0] == pytest.approx(curve.evaluate(t)[0], abs=1e-12)
    assert [part.item() for part in curve.evaluate(np.array(low))[:2]] == pytest.approx(
        [part.item() for part in curve.evaluate(np.array(high))[:2]], abs=1e-12
    )


def test_nearest_points_of_a_line_stay_between_its_ends() -> None:
    line = Line(start=(0.0, 0.0), end=(2.0, 0.0))
    assert line.nearest(np.array([-1.0, 0.5, 3.0]), np.array([1.0, 1.0, 1.0])).tolist() == [0.0, 0.5, 2.0]


def test_an_open_formula_named_closed_is_refused() -> None:
    round_trip = FormulaCurve(curve=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"), closed=True)
    assert round_trip.corners.tolist() == []
    drop = FormulaCurve(curve=em.Curve.of_expressions("sin(pi*t)", "sin(2*pi*t)"), closed=True)
    assert drop.corners.tolist() == [0.0]
    with pytest.raises(em.InputError, match=r"named closed, but begins at \(0, 0\) and ends at \(1, 0\), 1 apart"):
        FormulaCurve(curve=em.Curve.of_expressions("t", "t**2 - t"), closed=True)
