"""The metric on the reference square: that of the monitor, pulled back by the map of the domain."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.equations.metric import ReferenceMetric, quadratic

SECTOR = em.AnnulusSector(center=(1, 0), angles=(-30, 80))
S, T = np.random.default_rng(8).random((2, 30))
TENSOR = em.Tensor(m11=em.Expression("2 + x"), m12=em.Expression("y/3"), m22=em.Expression("4"))


def test_lengths_on_the_reference_square_are_those_of_the_images() -> None:
    metric = ReferenceMetric(TENSOR.on(SECTOR), SECTOR)
    x_s, x_t, y_s, y_t = SECTOR.jacobian(S, T)
    d = np.cos(7 * S), np.sin(5 * T)
    image = x_s * d[0] + x_t * d[1], y_s * d[0] + y_t * d[1]
    expected = quadratic(TENSOR.metric(*SECTOR.map(S, T)), image)
    assert quadratic(metric.base(S, T), d) == pytest.approx(expected)


def test_the_base_of_the_arc_length_is_the_map_alone_and_u_is_differentiated_through_it() -> None:
    metric = ReferenceMetric(em.ArcLength(u=em.Expression("x**2*y")), SECTOR)
    x_s, x_t, y_s, y_t = SECTOR.jacobian(S, T)
    assert np.array(metric.base(S, T)) == pytest.approx(np.array([x_s**2 + y_s**2, 0 * S, x_t**2 + y_t**2]), abs=1e-12)
    h = 1e-6
    u, u_s, u_t = metric.u_with_gradient(S, T)
    assert u == pytest.approx(metric.u(S, T))
    assert u_s == pytest.approx((metric.u(S + h, T) - metric.u(S - h, T)) / (2 * h), abs=1e-8)
    assert u_t == pytest.approx((metric.u(S, T + h) - metric.u(S, T - h)) / (2 * h), abs=1e-8)


def test_a_turned_metric_exchanges_points_and_entries() -> None:
    metric = ReferenceMetric(TENSOR.on(SECTOR), SECTOR)
    turned = ReferenceMetric(TENSOR.on(SECTOR), SECTOR, turned=True)
    assert np.array(turned.base(T, S)) == pytest.approx(np.array(metric.base(S, T))[::-1])


def test_slopes_of_the_base_are_known_to_vanish_where_the_map_is_linear() -> None:
    arc_length = em.ArcLength(u=em.Expression("x*y"))
    assert ReferenceMetric(arc_length, em.Rectangle(x=(0, 3))).base_slopes(S, T) is None
    found = ReferenceMetric(arc_length, em.AnnulusSector(radii=(1, 3))).base_slopes(S, T)
    assert found is not None
    # x_t^2 + y_t^2 = (angle (1 + 2 s))^2, of which the derivative by s is 4 angle^2 (1 + 2 s).
    assert found[0][2] == pytest.approx((np.pi / 2) ** 2 * 4 * (1 + 2 * S), rel=1e-6)
    assert found[1][2] == pytest.approx(0 * S, abs=1e-6)


@pytest.mark.parametrize(
    ("u", "expected"), [("x + y - 1", 1.0), ("7", 1.0), ("1000 + x", 1001.0), ("1e6 - y", 1e6)], ids=str
)
def test_cancellation_is_the_size_of_u_over_its_variation(u: str, expected: float) -> None:
    assert ReferenceMetric(em.ArcLength(u=em.Expression(u)), em.Rectangle()).cancellation == pytest.approx(expected)


def test_other_monitors_do_not_see_u_through_the_mesh() -> None:
    metric = ReferenceMetric(TENSOR.on(SECTOR), SECTOR)
    assert metric.arc_length is None
    assert not metric.on_unit_square
    assert not np.any(metric.u_with_gradient(S, T))
    k, slope, raised = metric.strength((S, T), metric.base(S, T))
    assert not np.any(k)
    assert not np.any(slope)
    assert not np.any(raised)
