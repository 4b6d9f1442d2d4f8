"""Subdomains that exchange functionals: classical data where a condition has no solution."""

from __future__ import annotations

import equimesh as em
from cases import problem
from solver.schwarz.runs import LINEAR_ROBIN


def test_robin_that_finds_no_solution_is_rescued_and_reported() -> None:
    """Linear Robin with p = auto has no solution on blocks of the paper's function in the first iteration."""
    solution = em.solve(problem("paper", 17), LINEAR_ROBIN)
    assert any(r.classical for r in solution.iterations[1].subdomains)
    assert "classical data took its place" in solution.message
