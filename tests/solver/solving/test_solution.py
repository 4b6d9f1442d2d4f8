"""Solutions: their convergence, and measures that do not depend on what is read first."""

from __future__ import annotations

import numpy as np

import equimesh as em
from cases import problem
from solver.schwarz.runs import PAPER


def test_measures_do_not_depend_on_what_is_read_first() -> None:
    for case in (PAPER, problem("tanh20", 65)):
        first, second = em.solve(case), em.solve(case)
        q_eq, gain = first.data().q_eq, first.certificate.interpolation
        assert np.array_equal(q_eq, first.quality.q_eq.cells)
        assert second.quality.interpolation_error == first.quality.interpolation_error == gain
        assert np.array_equal(second.data().q_eq, q_eq)


def test_convergence_is_plain_numbers() -> None:
    convergence = em.solve(PAPER, em.Schwarz(tolerance=1e-6)).convergence()
    first, last = convergence["iterations"][0], convergence["iterations"][-1]
    assert first["change"] is None
    assert first["error"] is None
    assert type(last["max_q_eq"]) is float
    assert last["subdomains"][0]["status"] == "converged"
    assert convergence["predicted_rate"] == 0.0
