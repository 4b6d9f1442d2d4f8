"""Transmission conditions: which take fewer iterations."""

from __future__ import annotations

import equimesh as em
from solver.schwarz.runs import PAPER


def test_wider_overlap_and_robin_conditions_take_fewer_iterations() -> None:
    counts = {}
    for condition, overlap in [(em.Classical(), 2), (em.Classical(), 4), (em.Classical(), 8), (em.LinearRobin(), 2)]:
        settings = em.Schwarz(
            overlap=overlap,
            transmission=condition,
            ordering=em.Ordering.ALTERNATING,
            tolerance=1e-8,
            max_iterations=150,
        )
        counts[condition.name, overlap] = len(em.solve(PAPER, settings).iterations) - 1
    assert counts == {("classical", 2): 74, ("classical", 4): 25, ("classical", 8): 12, ("linear_robin", 2): 4}
