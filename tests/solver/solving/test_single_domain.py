"""Single-domain solves: their endings."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem


def test_a_newton_failure_says_where_and_folds_nothing() -> None:
    hopeless = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)
    with pytest.raises(em.SolveError, match="and a cross-line term") as caught:
        em.solve(hopeless, allow_relaxed=False)
    assert caught.value.solution.status is em.Status.NEWTON_FAILED
    assert not caught.value.solution.mesh.is_folded
