"""What every monitor promises: a positive definite metric, binding to a domain, pickling."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import SECTOR, UNIT, every, matrices, monitors, points


@every
@pytest.mark.parametrize("domain", [UNIT, SECTOR], ids=["square", "sector"])
def test_every_metric_is_positive_definite_and_keeps_the_shape_of_the_points(name: str, domain: em.Domain) -> None:
    monitor = monitors()[name].on(domain)
    x, y = points(domain, 64)
    metric = monitor.metric(x, y)
    assert all(entry.shape == x.shape for entry in metric)
    assert np.linalg.eigvalsh(matrices(metric)).min() > 1e-3
    strided = monitor.metric(x[::3, ::2], y[::3, ::2])
    assert matrices(strided) == pytest.approx(matrices(metric)[::3, ::2], rel=1e-12)


@every
def test_binding_again_to_the_same_domain_costs_nothing(name: str) -> None:
    bound = monitors()[name].on(UNIT)
    assert bound.on(em.Rectangle()) is bound
    weak = bound.weakened(0.5)
    assert weak.on(UNIT) is weak


@every
def test_a_bound_monitor_can_be_pickled(name: str) -> None:
    monitor, (x, y) = monitors()[name].on(UNIT), points(n=9)
    copy = pickle.loads(pickle.dumps(monitor))
    assert np.array_equal(matrices(copy.metric(x, y)), matrices(monitor.metric(x, y)))
