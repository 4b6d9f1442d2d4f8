"""Problems on blocks: the monitors that they take, and what is said to others."""

from __future__ import annotations

import re

import pytest

import equimesh as em
from equimesh.testing.geometries import l_shape

U = em.Expression("tanh(9*(x + y))")


@pytest.mark.parametrize("monitor", [em.LeastError(u=U), em.Auto(u=U)])
def test_monitors_are_bound_to_the_domain(monitor: em.LeastError | em.Auto) -> None:
    problem = em.Problem(monitor=monitor, domain=l_shape(300))
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
        em.Problem(monitor=monitor, domain=l_shape(300))
    assert caught.value.field == field


def test_a_round_does_not_bound_angles() -> None:
    domain = l_shape(300)
    u = em.QuadField(mesh=domain.mesh, values=domain.mesh.x)
    with pytest.raises(em.InputError, match="take LeastError with the same values") as caught:
        em.Problem(monitor=em.NodalSolution(u=u, orthogonality=50.0), domain=domain)
    assert caught.value.field == "monitor.orthogonality"


def test_blocks_have_no_grid_and_domains_with_four_sides_need_one() -> None:
    domain, grid = l_shape(300), em.Grid(n_xi=5, n_eta=5)
    with pytest.raises(em.InputError, match="leave the grid out, and refine the blocks") as caught:
        em.Problem(monitor=em.Auto(u=U), grid=grid, domain=domain)
    assert caught.value.field == "grid"
    with pytest.raises(em.InputError, match="leave the boundary out") as caught:
        em.Problem(monitor=em.Auto(u=U), boundary=em.Boundary.ORTHOGONAL, domain=domain)
    assert caught.value.field == "boundary"
    with pytest.raises(em.InputError, match=r"give Grid\(n_xi=") as caught:
        em.Problem(monitor=em.Auto(u=U), domain=em.Rectangle())
    assert caught.value.field == "grid"


@pytest.mark.parametrize(
    ("name", "now"),
    [
        ("BlockProblem", "Problem"),
        ("BlockSolution", "Solution"),
        ("BlockSchwarz", "Schwarz"),
        ("BlockSequence", "Sequence"),
        ("BlockStep", "SequenceStep"),
    ],
)
def test_names_before_say_the_name_now(name: str, now: str) -> None:
    with pytest.raises(AttributeError, match=f"equimesh.{name} is equimesh.{now} now"):
        getattr(em, name)
    assert name not in em.__all__
    assert now in em.__all__
