"""Solutions: what they say of their convergence."""

from __future__ import annotations

import equimesh as em
from solver.schwarz.runs import PAPER


def test_convergence_is_plain_numbers() -> None:
    convergence = em.solve(PAPER, em.Schwarz(tolerance=1e-6)).convergence()
    first, last = convergence["iterations"][0], convergence["iterations"][-1]
    assert first["change"] is None
    assert first["error"] is None
    assert type(last["max_q_eq"]) is float
    assert last["subdomains"][0]["status"] == "converged"
    assert convergence["predicted_rate"] == 0.0
