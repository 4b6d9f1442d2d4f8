"""Metric lengths of directions, and their derivatives, against difference quotients."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.equations.mesh_equations import HalfFlux, LocalMetric, SeenGradient
from equimesh.equations.metric import ReferenceMetric, Vector

STEP = 1e-6
ARC_LENGTH = em.ArcLength(u=em.Expression("sin(3*x)*y"), a=0.8, b=0.3)
WEIGHT = em.Weight(rho=em.Expression("1 + x**2 + 2*y"))
SECTOR = em.AnnulusSector(angles=(0, 100))

each_metric = pytest.mark.parametrize(
    "metric",
    [ReferenceMetric(m, d) for m in (ARC_LENGTH, WEIGHT) for d in (em.Rectangle(), SECTOR)],
    ids=["arc length", "arc length on a sector", "weight", "weight on a sector"],
)


def pair(first: float, second: float) -> Vector:
    return np.array([first]), np.array([second])


def half_flux(metric: ReferenceMetric, d: Vector, g: Vector, point: Vector) -> HalfFlux:
    return HalfFlux(d, LocalMetric(metric, point, g))


def slopes(metric: ReferenceMetric, varied: str) -> list[float]:
    """The difference quotients of the flux by the two components of one of its arguments."""
    given = {"d": pair(0.7, -0.4), "g": pair(1.1, 0.6), "point": pair(0.3, 0.8)}
    found = []
    for component in (0, 1):
        values = []
        for h in (STEP, -STEP):
            moved = [q.copy() for q in given[varied]]
            moved[component] += h
            values.append(half_flux(metric, **(given | {varied: (moved[0], moved[1])})).value[0])
        found.append((values[0] - values[1]) / (2 * STEP))
    return found


@each_metric
def test_the_derivatives_of_a_flux(metric: ReferenceMetric) -> None:
    flux = half_flux(metric, pair(0.7, -0.4), pair(1.1, 0.6), pair(0.3, 0.8))
    assert np.ravel(flux.by_direction) == pytest.approx(slopes(metric, "d"), abs=1e-7)
    assert np.ravel(flux.by_gradient) == pytest.approx(slopes(metric, "g"), abs=1e-7)
    by_position = [0.0, 0.0] if flux.by_position is None else np.ravel(flux.by_position)
    assert by_position == pytest.approx(slopes(metric, "point"), abs=1e-6)


@each_metric
def test_the_metric_length_is_a_square_of_the_direction(metric: ReferenceMetric) -> None:
    one = half_flux(metric, pair(0.7, -0.4), pair(1.1, 0.6), pair(0.3, 0.8)).value
    two = half_flux(metric, pair(-1.4, 0.8), pair(1.1, 0.6), pair(0.3, 0.8)).value
    assert one > 0
    assert two == pytest.approx(4 * one)


def test_the_gradient_of_a_linear_function_is_seen_exactly() -> None:
    """u = 2x - 3y, seen through any map x(xi, eta), y(xi, eta)."""
    x_xi, y_xi, x_eta, y_eta = np.random.default_rng(4).uniform(0.5, 1.0, (4, 6)) * [[1], [0.2], [-0.3], [1]]
    seen = SeenGradient(x_xi, y_xi, x_eta, y_eta, 2 * x_xi - 3 * y_xi, 2 * x_eta - 3 * y_eta)
    assert (seen.jacobian > 0).all()
    assert np.array(seen.gradient) == pytest.approx(np.array([[2.0] * 6, [-3.0] * 6]))
