"""Transmission conditions: which take fewer iterations."""

from __future__ import annotations

import equimesh as em
from solver.schwarz.runs import PAPER

# Iterations by condition and overlap. Blessed numbers: those of today's solver. Where a change moves them by more than
# one, look for the reason in the conditions; write new ones here in the commit that explains them.
BLESSED_ITERATIONS = {("classical", 2): 74, ("classical", 4): 25, ("classical", 8): 12, ("linear_robin", 2): 4}


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
    assert counts == BLESSED_ITERATIONS
