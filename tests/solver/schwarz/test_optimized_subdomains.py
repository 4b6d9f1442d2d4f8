"""Subdomains with the optimized condition: Newton's method where their sweeps fail."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import NewtonSolution
from equimesh.schwarz.subdomains import SubdomainSweeps


def test_newton_helps_where_sweeps_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_self: SubdomainSweeps, start: em.Mesh, *_: object, **__: object) -> NewtonSolution:
        return NewtonSolution(start, 3, np.inf, converged=False, swept=True)

    monkeypatch.setattr(SubdomainSweeps, "solve", fail)
    settings = em.Schwarz(subdomains=(2, 2), line_correction=0)
    solution = em.solve(problem("paper", 17), settings)
    assert solution.status is em.Status.CONVERGED
    records = [record for iteration in solution.iterations[1:] for record in iteration.subdomains]
    assert any(record.newton_steps for record in records)
    assert not any(record.stalled or record.sweeps for record in records)
