"""Curvature monitors: Huang's tensors, their area, and what does not count as curvature."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import SECTOR, STEEP, UNIT, matrices, points, triple


@pytest.mark.parametrize("domain", [UNIT, SECTOR, em.Rectangle(x=(0.0, 300.0), y=(-1.0, 50.0))])
@pytest.mark.parametrize("isotropic", [False, True])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_half_of_the_metric_s_area_is_that_of_the_domain(domain: em.Domain, isotropic: bool, norm: str) -> None:
    u = em.Expression("exp(-((x - 1)**2 + (y + 2)**2)) + 0.01*x*y")
    monitor = em.Curvature(u=u, isotropic=isotropic, norm=norm).on(domain)  # type: ignore[arg-type]
    middle = (np.arange(600) + 0.5) / 600
    s, t = np.meshgrid(middle, middle, indexing="ij")
    m11, m12, m22 = monitor.metric(*domain.map(s, t))
    x_s, x_t, y_s, y_t = domain.jacobian(s, t)
    total = np.mean(np.sqrt(m11 * m22 - m12**2) * (x_s * y_t - x_t * y_s))
    assert total == pytest.approx(2 * domain.area, rel=2e-3)


@pytest.mark.parametrize(("p", "q"), [(3.0, 1.0), (2.0, -0.5), (-1.0, -1.0)])
def test_the_tensors_of_huang_for_a_quadratic(p: float, q: float) -> None:
    # H = diag(p, q) everywhere, turned by 0.4; a tiny floor leaves |H| alone.
    (h11,), (h12,), (h22,) = triple(0.4, p, q)
    u = em.Expression(
        "h11*x**2/2 + h12*x*y + h22*y**2/2 + x - 2*y + 5", parameters={"h11": h11, "h12": h12, "h22": h22}
    )
    x, y = points(n=7)
    for norm in ("l2", "h1"):
        monitor = em.Curvature(u=u, norm=norm, floor=1e-9).on(UNIT)  # type: ignore[arg-type]
        assert monitor.alpha is not None
        first, second = 1 + abs(p) / monitor.alpha, 1 + abs(q) / monitor.alpha
        l2, h1 = (first * second) ** (-1 / 6), (first * second) ** (-1 / 4) * ((first + second) / 2) ** 0.5
        scale = l2 if norm == "l2" else h1
        expected = matrices(triple(0.4, scale * first, scale * second))[0]
        got = matrices(monitor.metric(x, y))
        assert got == pytest.approx(np.broadcast_to(expected, got.shape), rel=1e-6)
        assert np.linalg.det(expected) == pytest.approx(4.0, rel=1e-8)  # the area in M is twice that of the square
        round_one = em.Curvature(u=u, norm=norm, isotropic=True).on(UNIT).metric(x, y)  # type: ignore[arg-type]
        assert matrices(round_one) == pytest.approx(np.broadcast_to(2 * np.eye(2), got.shape), abs=1e-8)


@pytest.mark.parametrize("text", ["2*x - 3*y", "7", "0"])
def test_the_curvature_of_a_linear_function_is_a_multiple_of_the_identity(text: str) -> None:
    monitor = em.Curvature(u=em.Expression(text)).on(SECTOR)
    assert monitor.alpha == math.inf
    m11, m12, m22 = monitor.metric(*points(SECTOR, 5))
    assert np.ptp(m11) == np.ptp(m22) == 0.0
    assert np.array_equal(m11, m22)
    assert not m12.any()


def test_rounding_in_linear_samples_is_not_curvature() -> None:
    axis = np.linspace(0, 1, 300)
    samples = em.GridSamples(x=axis, y=axis, values=1e3 + 0.1 * axis[:, None] + 0.7 * axis)
    assert np.abs(samples.evaluate(axis, axis, order=2)[3]).max() > 0
    assert em.Curvature(u=samples).on(UNIT).alpha == math.inf


def test_the_curvature_does_not_know_the_size_of_u_or_of_the_domain() -> None:
    x, y = points()
    one = em.Curvature(u=em.Expression("sin(3*x)*exp(y)")).on(UNIT).metric(x, y)
    two = em.Curvature(u=em.Expression("1e6*sin(3*x/50)*exp(y/50)")).on(em.Rectangle(x=(0, 50), y=(0, 50)))
    assert matrices(two.metric(50 * x, 50 * y)) == pytest.approx(matrices(one), rel=1e-9)


def test_a_curvature_monitor_wants_a_domain_and_second_derivatives() -> None:
    unbound = em.Curvature(u=STEEP)
    with pytest.raises(em.InputError, match=r"monitor\.on\(domain\)"):
        unbound.metric(*points(n=3))
    with pytest.raises(em.InputError, match=r"second derivatives are not finite at \(x, y\)") as caught:
        em.Curvature(u=em.Expression("where(x > 0.5, (x - 0.75)**1.5, 0)")).on(UNIT)
    assert caught.value.field == "u"
    bound = unbound.on(UNIT)
    assert bound.on(SECTOR).alpha == unbound.on(SECTOR).alpha != bound.alpha
    assert replace(bound, norm="h1").alpha is None
    for wrong, field in (({"norm": "max"}, "norm"), ({"floor": 0.0}, "floor"), ({"floor": math.nan}, "floor")):
        with pytest.raises(em.InputError, match=field) as caught:
            em.Curvature(u=STEEP, **wrong)  # type: ignore[arg-type]
        assert caught.value.field == field
