"""The pieces of an axis: every point lies on the piece that a search finds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline, make_interp_spline

from equimesh.fields.bicubic import ORDER, Axis, at_piece, buckets_per_length, piece


def knots_of(points: np.ndarray) -> np.ndarray:
    return np.asarray(make_interp_spline(points, points).t)


@pytest.mark.parametrize("power", [1.0, 6.0], ids=["even", "graded"])
def test_every_point_has_its_piece(power: float) -> None:
    axis = Axis.of(knots_of(np.linspace(0.0, 1.0, 40) ** power))
    scale = buckets_per_length(axis)
    last = axis.breaks.size - 2
    for t in [*axis.breaks, *np.random.default_rng(1).random(300), *np.nextafter(axis.breaks[1:], 0.0)]:
        expected = min(int(np.searchsorted(axis.breaks, t, side="right")) - 1, last)
        assert piece(t, axis, scale) == expected


def test_the_cubics_are_the_b_splines() -> None:
    knots = knots_of(np.linspace(0.0, 2.0, 9) ** 1.5)
    axis = Axis.of(knots)
    for number, begin in enumerate(axis.breaks[:-1]):
        t = 0.3 * begin + 0.7 * axis.breaks[number + 1]
        expected = BSpline.design_matrix([t], knots, 3).toarray()[0, number : number + ORDER]
        assert at_piece(axis.cubics, number, t - begin) == pytest.approx(expected, abs=1e-14)
