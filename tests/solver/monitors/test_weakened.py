"""Weakened monitors: between a multiple of the identity and the monitor itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from solver.monitors.metrics import UNIT, every, matrices, monitors, points


@every
def test_the_strengths_between_nothing_and_the_monitor_itself(name: str) -> None:
    monitor = monitors()[name].on(UNIT)
    x, y = points(n=31)
    own = matrices(monitor.metric(x, y))
    assert matrices(monitor.weakened(1.0).metric(x, y)) == pytest.approx(own, rel=1e-12)
    flat = matrices(monitor.weakened(0.0).metric(x, y))
    assert flat == pytest.approx(flat[0, 0, 0, 0] * np.broadcast_to(np.eye(2), flat.shape), abs=1e-12)
    spread = [np.linalg.cond(matrices(monitor.weakened(s).metric(x, y))).max() for s in (0.0, 0.3, 0.6, 1.0)]
    assert spread == sorted(spread)
    again = monitor.weakened(0.5).weakened(0.5).metric(x, y)
    assert matrices(again) == pytest.approx(matrices(monitor.weakened(0.25).metric(x, y)), rel=1e-9)
    for wrong in (-0.1, 1.1, math.nan):
        with pytest.raises(em.InputError, match="strength"):
            monitor.weakened(wrong)


@every
def test_weakening_and_binding_commute(name: str) -> None:
    monitor, (x, y) = monitors()[name], points(n=9)
    first, second = monitor.weakened(0.4).on(UNIT), monitor.on(UNIT).weakened(0.4)
    assert first.metric(x, y)[0] == pytest.approx(second.metric(x, y)[0], rel=1e-12)
