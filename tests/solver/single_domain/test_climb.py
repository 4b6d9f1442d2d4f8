"""The levels of a nested iteration."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.single_domain import iteration


@pytest.mark.parametrize("u", ["tanh(20*(x + y/2 - 0.6))", "tanh(20*(y - 0.5 - 0.25*sin(2*pi*x)))"])
def test_half_the_monitor_leads_up_to_one_on_which_sweeps_fail(u: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = em.Problem(monitor=em.ArcLength(u=em.Expression(u), scaled=False), grid=em.Grid(n_xi=33, n_eta=33))

    def strengths() -> list[float]:
        seen: list[float] = []
        solution = em.solve(problem, observe=lambda step: seen.append(step.strength))
        assert solution.status is em.Status.CONVERGED
        assert solution.certificate.relaxed == ()
        return sorted(set(seen))

    with monkeypatch.context() as patch:
        patch.setattr(iteration, "newton_level", None)  # no Newton step is needed
        assert strengths() == [0.5, 1.0]
        patch.setattr(iteration, "_weaker", lambda *_: iter(()))
        with pytest.raises(TypeError):  # but for what is tested here
            strengths()
