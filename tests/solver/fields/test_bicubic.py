"""The compiled bicubic spline is FITPACK's, in value and derivatives, everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from equimesh.fields.bicubic import Bicubic

PARTIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


@pytest.mark.parametrize(("n_x", "n_y", "grading"), [(4, 4, 1.0), (5, 7, 1.0), (33, 50, 3.0), (40, 6, 6.0)])
def test_it_is_fitpacks(n_x: int, n_y: int, grading: float) -> None:
    random = np.random.default_rng(7)
    x, y = np.linspace(0.0, 1.0, n_x) ** grading, np.linspace(-2.0, 3.0, n_y)
    spline = RectBivariateSpline(x, y, random.standard_normal((n_x, n_y)), s=0)
    points = [np.concatenate([axis, random.uniform(axis[0] - 0.3, axis[-1] + 0.3, 500)]) for axis in (x, y)]
    first, second = np.meshgrid(*points, indexing="ij")
    found = Bicubic.of(spline).evaluate(first, second, order=2)
    for values, (dx, dy) in zip(found, PARTIALS, strict=True):
        expected = spline(first, second, dx=dx, dy=dy, grid=False)
        assert np.abs(values - expected).max() <= 1e-13 * np.abs(expected).max()


def test_beyond_the_ends_and_nowhere() -> None:
    axis = np.linspace(0.0, 1.0, 6)
    bicubic = Bicubic.of(RectBivariateSpline(axis, axis, np.add.outer(axis, 2.0 * axis), s=0))
    x, y = np.array([-np.inf, 7.0, np.nan, 0.5]), np.array([0.25, np.inf, 0.5, np.nan])
    values, slope, _ = bicubic.evaluate(x, y, order=1)
    np.testing.assert_allclose(values[:2], [0.5, 3.0], atol=1e-14)
    np.testing.assert_allclose(slope[:2], 1.0, atol=1e-13)
    assert np.isnan(values[2:]).all()
    assert np.isnan(slope[2:]).all()


def test_fewer_derivatives_are_the_same_ones() -> None:
    axis = np.linspace(0.0, 1.0, 9)
    bicubic = Bicubic.of(RectBivariateSpline(axis, axis, np.sin(np.multiply.outer(9.0 * axis, axis)), s=0))
    x = np.linspace(0.0, 1.0, 101)
    every = bicubic.evaluate(x, x[::-1], order=2)
    for order, count in ((0, 1), (1, 3)):
        some = bicubic.evaluate(x, x[::-1], order=order)
        assert len(some) == count
        np.testing.assert_allclose(some, every[:count], rtol=1e-14, atol=1e-15 * np.abs(every[:count]).max())


def test_slopes_are_bounded_as_fitpack_bounds_them() -> None:
    x, y = np.linspace(0.0, 1.0, 9) ** 2, np.linspace(-1.0, 2.0, 6)
    spline = RectBivariateSpline(x, y, np.random.default_rng(5).standard_normal((9, 6)), s=0)
    expected = [np.abs(spline.partial_derivative(*by).get_coeffs()).max() for by in ((1, 0), (0, 1))]
    np.testing.assert_allclose(Bicubic.of(spline).steepest, expected, rtol=1e-12)
