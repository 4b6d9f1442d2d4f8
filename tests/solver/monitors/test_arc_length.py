"""The arc-length monitor of the paper."""

from __future__ import annotations

import equimesh as em
from solver.monitors.metrics import STEEP


def test_the_arc_length_weakens_by_its_own_parameter() -> None:
    assert em.ArcLength(u=STEEP, a=0.8).weakened(0.5) == em.ArcLength(u=STEEP, a=0.4)
