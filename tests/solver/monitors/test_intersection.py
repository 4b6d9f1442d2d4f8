"""Intersections dominate each of their monitors."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.monitors.monitor import Monitor
from solver.monitors.metrics import STEEP, UNIT, WAVE, matrices, points


def test_an_intersection_dominates_its_monitors_and_takes_the_first_u() -> None:
    weight = em.Weight(rho=em.Expression("1 + 20*x"))
    parts: tuple[Monitor, ...] = (weight, em.Curvature(u=WAVE), em.ArcLength(u=STEEP, a=1.0))
    both = em.Intersection(monitors=parts).on(UNIT)
    x, y = points()
    metric = matrices(both.metric(x, y))
    for part in both.monitors:
        assert np.linalg.eigvalsh(metric - matrices(part.metric(x, y))).min() > -1e-9
    assert both.u is WAVE
    assert em.Intersection(monitors=(weight, weight)).u is None
    for number in (1, 9):
        with pytest.raises(em.InputError, match="2 to 8"):
            em.Intersection(monitors=(weight,) * number)


def test_a_gradient_map_in_an_intersection_is_refused() -> None:
    rho = em.Expression("1 + x")
    with pytest.raises(em.InputError, match="leave out map") as caught:
        em.Intersection(monitors=(em.Weight(rho=rho), em.Weight(rho=rho, map="gradient")))
    assert caught.value.field == "monitors.1.map"
