"""Functions that repeat themselves with a periodic rectangle."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.fields.periodic import Periodic, repeated, repeated_field, within

DOMAIN = em.Rectangle(x=(-1.0, 1.0), y=(0.0, 1.0), periodic="x")


def test_points_are_moved_by_whole_periods() -> None:
    x, y = np.array([-3.5, -1.0, 0.25, 1.0, 2.5]), np.array([2.0, 0.0, 0.5, 1.0, -1.0])
    there = within(DOMAIN, x, y)
    assert np.allclose(there[0], [0.5, -1.0, 0.25, 1.0, 0.5], atol=1e-15)
    assert there[1] is y


def test_values_repeat_and_stay_to_the_last_bit_inside() -> None:
    u = em.Expression("sin(pi*x) + y*cos(2*pi*x)")
    field = repeated_field(u, DOMAIN, "u")
    x, y = np.array([-0.9, 0.3, 0.99]), np.array([0.1, 0.5, 0.7])
    assert np.array_equal(field.evaluate(x, y, 2), u.evaluate(x, y, 2))
    assert np.allclose(field.evaluate(x + 4.0, y, 2), u.evaluate(x, y, 2), atol=1e-10)


def test_a_function_that_jumps_is_refused_with_both_values() -> None:
    with pytest.raises(em.InputError, match=r"u is -1 and 1 where y = 0; take a u that repeats itself") as error:
        em.Problem(monitor=em.ArcLength(u=em.Expression("x")), grid=em.Grid(n_xi=9, n_eta=9), domain=DOMAIN)
    assert error.value.field == "domain.periodic"


def test_samples_are_joined_smoothly_across_the_seam() -> None:
    x, y = np.linspace(-1.0, 1.0, 21), np.linspace(0.0, 1.0, 9)
    samples = em.GridSamples(x=x, y=y, values=np.sin(np.pi * x)[:, None] * (1.0 + y), box=DOMAIN.box)
    field = repeated_field(samples, DOMAIN, "u")
    ends, middle = np.array([-1.0, 1.0]), np.full(2, 0.5)
    slopes = field.evaluate(ends, middle, 2)
    assert abs(slopes[1][0] - slopes[1][1]) < 1e-4 < abs(np.subtract(*samples.evaluate(ends, middle, 2)[1])) + 1e-3
    assert abs(slopes[3][0] - slopes[3][1]) < 0.02 * np.pi**2
    assert np.allclose(field.evaluate(x, np.full(21, y[3]))[0], samples.values[:, 3], atol=1e-13)


def test_all_functions_of_a_monitor_repeat_themselves_once() -> None:
    u = em.Expression("cos(pi*x)")
    monitor = em.Intersection(monitors=(em.Smoothed(monitor=em.Curvature(u=u)), em.Weight(rho=em.Expression("1+y"))))
    found = repeated(monitor, DOMAIN)
    assert isinstance(found.monitors[0].monitor.u, Periodic)
    assert isinstance(found.monitors[1].rho, Periodic)
    assert repeated(found, DOMAIN) is found
    assert repeated(monitor, em.Rectangle()) is monitor
