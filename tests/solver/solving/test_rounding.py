"""Problems that are lost in rounding."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.solving.single_domain import MAX_ROUNDING_RESIDUAL


@pytest.mark.parametrize("schwarz", [None, em.Schwarz()], ids=["single domain", "schwarz"])
@pytest.mark.parametrize("size", ["1e11", "1e13", "1e15"])
def test_a_function_that_is_lost_in_rounding_never_counts_as_solved(size: str, schwarz: em.Schwarz | None) -> None:
    u = em.Expression(f"{size} + tanh(20*(x - y**2))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    for mode in em.Mode:
        solution = em.solve(problem, schwarz, mode=mode, check=False)
        assert solution.status is em.Status.NEWTON_FAILED
        assert solution.residual > MAX_ROUNDING_RESIDUAL
        assert "times as large as it varies" in solution.message
        assert solution.message.endswith(
            "Subtract a constant from u, so that its values are not much larger than it varies."
        )
        assert solution.convergence()["iterations"] == []
    with pytest.raises(em.SolveError, match="Subtract a constant"):
        em.solve(problem, schwarz)


def test_a_smaller_constant_is_no_obstacle() -> None:
    u = em.Expression("1e7 + tanh(20*(x - y**2))")
    problem = em.Problem(monitor=em.ArcLength(u=u), grid=em.Grid(n_xi=33, n_eta=33))
    assert em.solve(problem).status is em.Status.CONVERGED
