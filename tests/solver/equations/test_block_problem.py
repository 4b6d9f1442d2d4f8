"""Problems on blocks: the monitors that they take, and what is said to others."""

from __future__ import annotations

import re

import pytest

import equimesh as em
from equimesh.testing.geometries import l_shape

U = em.Expression("tanh(9*(x + y))")


@pytest.mark.parametrize("monitor", [em.LeastError(u=U), em.Auto(u=U)])
def test_monitors_are_bound_to_the_domain(monitor: em.LeastError | em.Auto) -> None:
    problem = em.BlockProblem(monitor=monitor, domain=l_shape(300))
    assert problem.points == problem.domain.points
    assert problem.monitor.on(problem.domain) is problem.monitor


@pytest.mark.parametrize(
    ("monitor", "field", "text"),
    [
        (em.ArcLength(u=U), "monitor", "re-entrant corners"),
        (em.Curvature(u=U), "monitor", "LeastError"),
        (em.LeastError(u=U, rectilinear=True), "monitor.rectilinear", "no lines that could stay straight"),
        (em.Auto(u=U, purpose="finite_volume"), "monitor.purpose", "orthogonality"),
        (em.LeastError(u=em.Expression("1/(x + 100) + log(x)")), "u", "not finite at"),
    ],
)
def test_other_requests_are_refused_with_what_to_do(monitor: em.Monitor, field: str, text: str) -> None:
    with pytest.raises(em.InputError, match=re.escape(text)) as caught:
        em.BlockProblem(monitor=monitor, domain=l_shape(300))  # type: ignore[arg-type]
    assert caught.value.field == field


def test_a_round_does_not_bound_angles() -> None:
    domain = l_shape(300)
    u = em.QuadField(mesh=domain.mesh, values=domain.mesh.x)
    with pytest.raises(em.InputError, match="take LeastError with the same values") as caught:
        em.BlockProblem(monitor=em.NodalSolution(u=u, orthogonality=50.0), domain=domain)
    assert caught.value.field == "monitor.orthogonality"


def test_domains_of_the_other_problem_are_named() -> None:
    with pytest.raises(em.InputError, match=r"domain is of type Rectangle, .* Blocks\.of") as caught:
        em.BlockProblem(monitor=em.Auto(u=U), domain=em.Rectangle())  # type: ignore[arg-type]
    assert caught.value.field == "domain"
    with pytest.raises(em.InputError, match="BlockProblem"):
        em.Problem(monitor=em.Auto(u=U), grid=em.Grid(n_xi=5, n_eta=5), domain=l_shape(300))  # type: ignore[arg-type]
