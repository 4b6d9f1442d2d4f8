"""The request to choose a monitor: its values, its metric, its copies."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import SECTOR, UNIT, points

STEEP = em.Expression("tanh(20*(x + y/2 - 0.75))")


def test_its_metric_is_that_of_curvature_before_the_choice() -> None:
    x, y = points(n=9)
    for norm in ("l2", "h1"):
        own = em.Auto(u=STEEP, norm=norm).on(UNIT)
        curvature = em.Curvature(u=STEEP, norm=norm).on(UNIT)
        assert np.array_equal(own.metric(x, y), curvature.metric(x, y))
        assert np.array_equal(own.weakened(0.5).metric(x, y), curvature.weakened(0.5).metric(x, y))


@pytest.mark.parametrize(("field", "value"), [("norm", "linf"), ("u", 3.0)])
def test_what_is_refused_names_its_field(field: str, value: Any) -> None:
    with pytest.raises(em.InputError) as caught:
        em.Auto(**({"u": STEEP} | {field: value}))
    assert caught.value.field == field


def test_the_metric_needs_a_domain_and_binding_keeps_the_rest() -> None:
    monitor = em.Auto(u=STEEP, norm="h1")
    with pytest.raises(em.InputError, match="on\\(domain\\)"):
        monitor.metric(*points(n=2))
    with pytest.raises(em.InputError, match="on\\(domain\\)"):
        monitor.weakened(0.5)
    bound = monitor.on(UNIT)
    assert bound == monitor
    assert bound.on(UNIT) is bound
    assert bound.on(SECTOR) is not bound
    assert pickle.loads(pickle.dumps(bound)) == monitor


def test_u_must_be_finite_on_the_domain() -> None:
    with pytest.raises(em.InputError) as caught:
        em.Auto(u=em.Expression("log(x - 0.5)")).on(UNIT)
    assert caught.value.field == "u"
