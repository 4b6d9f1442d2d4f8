"""Smoothed monitors: the mean with a Gaussian, positive definite, without kinks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import equimesh as em
from solver.monitors.metrics import SECTOR, STEEP, UNIT, matrices, points


@pytest.mark.parametrize("domain", [UNIT, SECTOR, em.Rectangle(x=(0.0, 40.0))], ids=["square", "sector", "long"])
@pytest.mark.parametrize("radius", [1e-4, 0.01, 0.05, 0.25])
def test_a_smoothed_constant_is_the_constant(domain: em.Domain, radius: float) -> None:
    tensor = em.Tensor(m11=em.Expression("2"), m12=em.Expression("0.5"), m22=em.Expression("7"))
    smoothed = em.Smoothed(monitor=tensor, radius=radius).on(domain)
    for got, expected in zip(smoothed.metric(*points(domain)), (2.0, 0.5, 7.0), strict=True):
        assert got == pytest.approx(np.full(got.shape, expected), rel=1e-12)


def test_smoothing_is_the_mean_with_a_gaussian() -> None:
    # exp(k x) averaged with a Gaussian of deviation r is exp(k x + (k r)^2 / 2), away from the sides.
    weight = em.Weight(rho=em.Expression("exp(12*x - 5*y)"))
    for radius, domain in ((0.05, UNIT), (0.1, UNIT), (0.05, em.Rectangle(x=(0.0, 1.0), y=(-2.0, 1.0)))):
        x, y = np.meshgrid(np.linspace(0.45, 0.5, 50), np.linspace(0.5, 0.55, 50))
        got = em.Smoothed(monitor=weight, radius=radius).on(domain).metric(x, y)[0]
        expected = np.exp(12 * x - 5 * y + 0.5 * (12**2 + 5**2) * radius**2)
        assert got == pytest.approx(expected, rel=2e-3)
    # near a side the part of the Gaussian that lies inside counts: at x = 0 the half of it
    line = em.Smoothed(monitor=em.Weight(rho=em.Expression("1 + x")), radius=0.05).on(UNIT)
    value = line.metric(np.array([0.0]), np.array([0.5]))[0]
    assert value == pytest.approx([1 + 0.05 * math.sqrt(2 / math.pi)], abs=1e-3)


def test_a_smoothed_front_is_milder_and_its_metric_positive_definite_and_smooth() -> None:
    sharp = em.ArcLength(u=em.Expression("tanh(200*(x - y))"), a=1.0, b=0.0, scaled=False)
    x, y = points(n=301)
    low = []
    for radius in (0.002, 0.02, 0.1):
        smoothed = em.Smoothed(monitor=sharp, radius=radius).on(UNIT)
        metric = matrices(smoothed.metric(x, y))
        low.append(np.linalg.eigvalsh(metric).max())
        assert np.linalg.eigvalsh(metric).min() > 1 - 1e-9
    assert low == sorted(low, reverse=True)
    assert low[-1] < 0.1 * np.linalg.eigvalsh(matrices(sharp.metric(x, y))).max()
    line = np.linspace(0.3, 0.7, 20001)  # finer than the table: no kinks, no steps
    m11 = em.Smoothed(monitor=sharp, radius=0.1).on(UNIT).metric(line, 0 * line + 0.5)[0]
    step = line[1] - line[0]
    assert np.abs(np.diff(m11, 2)).max() < 3 * np.ptp(m11) * (step / 0.1) ** 2


def test_the_smoothed_metric_goes_on_beyond_the_sides() -> None:
    smoothed = em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False), radius=0.02).on(SECTOR)
    line = np.linspace(0, 1, 50)
    for s, t in ((0 * line, line), (0 * line + 1, line), (line, 0 * line), (line, 0 * line + 1)):
        inside = smoothed.metric(*SECTOR.map(s, t))[0]
        outside = smoothed.metric(*SECTOR.map(s + 1e-5 * (2 * s - 1), t + 1e-5 * (2 * t - 1)))[0]
        assert outside == pytest.approx(inside, rel=1e-3)


@pytest.mark.parametrize("radius", [0.0, -0.1, 0.3, math.nan])
def test_a_radius_out_of_range_is_refused(radius: float) -> None:
    with pytest.raises(em.InputError, match="radius") as caught:
        em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False), radius=radius)
    assert caught.value.field == "radius"


def test_an_unbound_smoothed_monitor_says_what_to_do() -> None:
    with pytest.raises(em.InputError, match=r"monitor\.on\(domain\)"):
        em.Smoothed(monitor=em.ArcLength(u=STEEP, scaled=False)).metric(*points(n=3))


@settings(max_examples=20, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.5, 80), st.floats(0.01, 0.25))
def test_smoothed_curvature_is_positive_definite(p: float, q: float, k: float, radius: float) -> None:
    u = em.Expression("p*tanh(k*(x - y**2)) + q*cos(9*x*y) + 0.01*x", parameters={"p": p, "q": q, "k": k})
    monitor = em.Smoothed(monitor=em.Curvature(u=u), radius=radius).on(UNIT)
    assert np.linalg.eigvalsh(matrices(monitor.metric(*points(n=41)))).min() > 0


def test_the_map_of_a_smoothed_weight_is_that_of_the_weight() -> None:
    rho = em.Expression("1 + x")
    assert em.Smoothed(monitor=em.Weight(rho=rho, map="gradient")).on(UNIT).map == "gradient"
    assert em.Smoothed(monitor=em.Weight(rho=rho)).map == "lines"
    assert em.Smoothed(monitor=em.ArcLength(u=rho)).map == "lines"
