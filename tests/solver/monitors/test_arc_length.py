"""The arc-length monitor of the paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import SECTOR, STEEP, UNIT, points

BOX = em.Rectangle(x=(1.0, 5.0), y=(0.0, 9.0))
X, Y = points(n=7)


def test_the_arc_length_weakens_by_its_own_parameter() -> None:
    assert em.ArcLength(u=STEEP, a=0.8).weakened(0.5) == em.ArcLength(u=STEEP, a=0.4)


def test_a_weaker_arc_length_keeps_its_scale() -> None:
    bound = em.ArcLength(u=em.Expression("10*x"), a=0.8).on(BOX)
    weaker = bound.weakened(0.5)
    assert weaker.factor == bound.factor == pytest.approx(6.0 / 40.0)
    assert weaker.on(BOX) is weaker
    assert bound.on(SECTOR).factor != bound.factor


def test_without_scaling_the_metric_is_the_formula_of_the_paper() -> None:
    monitor = em.ArcLength(u=em.Expression("3*x + 4*y"), a=0.5, b=0.1, scaled=False)
    k = 0.25 / (1 + 0.1 * 25)
    for bound in (monitor, monitor.on(BOX)):
        for entry, expected in zip(bound.metric(X, Y), (1 + 9 * k, 12 * k, 1 + 16 * k), strict=True):
            assert entry == pytest.approx(np.full_like(X, expected))


def test_the_gradient_is_that_of_u_over_its_range_by_lengths_over_the_size_of_the_domain() -> None:
    monitor = em.ArcLength(u=em.Expression("3*x + 4*y"), a=0.5, b=0.1).on(BOX)
    g = np.array([3.0, 4.0]) * math.sqrt(4 * 9) / (3 * 4 + 4 * 9)
    k = 0.25 / (1 + 0.1 * (g @ g))
    for entry, expected in zip(
        monitor.metric(X, Y), (1 + k * g[0] ** 2, k * g[0] * g[1], 1 + k * g[1] ** 2), strict=True
    ):
        assert entry == pytest.approx(np.full_like(X, expected))


@pytest.mark.parametrize("u", ["7", "sin(x)**2 + cos(x)**2", "1e17 + x"])
def test_a_constant_has_no_arc_length(u: str) -> None:
    bound = em.ArcLength(u=em.Expression(u)).on(UNIT)
    assert bound.factor == 0.0
    assert bound.metric(X, Y)[0] == pytest.approx(np.ones_like(X), abs=0)


def test_values_that_are_not_finite_have_no_part_in_the_range() -> None:
    assert em.ArcLength(u=em.Expression("5*y + 0/x")).on(UNIT).factor == pytest.approx(0.2)
    assert em.ArcLength(u=em.Expression("0/(x - x)")).on(UNIT).factor == 1.0


def test_an_unbound_arc_length_and_a_word_for_scaled_are_refused() -> None:
    with pytest.raises(em.InputError, match=r"call monitor\.on\(domain\) first"):
        em.ArcLength(u=STEEP).metric(X, Y)
    with pytest.raises(em.InputError, match="give True or False"):
        em.ArcLength(u=STEEP, scaled="no")  # type: ignore[arg-type]
