"""What is refused where lines are closed, and what a solve returns there."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em

GRID = em.Grid(n_xi=17, n_eta=17)
U = em.Expression("tanh(2*(sin(2*pi*x)*cos(2*pi*y)-0.2))")
DOMAIN = em.Rectangle(periodic="x")


@pytest.mark.parametrize(
    ("monitor", "schwarz", "field", "reason"),
    [
        (em.ArcLength(u=U), em.Schwarz(subdomains=(2, 1)), "schwarz", "the subdomains of a Schwarz iteration end"),
        (em.Weight(rho=em.Expression("1+y"), map="gradient"), None, "monitor.map", "take map = 'lines'"),
    ],
)
def test_what_needs_four_sides_is_refused(monitor: Any, schwarz: Any, field: str, reason: str) -> None:
    with pytest.raises(em.InputError, match=reason) as error:
        em.solve(em.Problem(monitor=monitor, grid=GRID, domain=DOMAIN), schwarz)
    assert error.value.field == field


MONITORS = {
    "arc length": em.ArcLength(u=U),
    "smoothed curvature": em.Smoothed(monitor=em.Curvature(u=U), radius=0.1),
    "weight": em.Weight(rho=em.Expression("1.5+sin(2*pi*x)*y")),
    "tensor": em.Tensor(m11=em.Expression("2+cos(2*pi*x)"), m12=em.Expression("0"), m22=em.Expression("1+y")),
    "intersection": em.Intersection(monitors=(em.ArcLength(u=U), em.Weight(rho=em.Expression("1+y")))),
}


@pytest.mark.parametrize("name", MONITORS)
def test_every_monitor_has_a_certified_mesh(name: str) -> None:
    solution = em.solve(em.Problem(monitor=MONITORS[name], grid=GRID, domain=DOMAIN), mode="tight")
    assert solution.status is em.Status.CONVERGED
    residual = solution.certificate.equation_residual
    assert residual is not None
    assert residual < 1e-11
    assert np.array_equal(solution.mesh.x[-1], solution.mesh.x[0] + 1.0)


def test_a_start_must_be_closed() -> None:
    problem = em.Problem(monitor=em.ArcLength(u=U), grid=GRID, domain=DOMAIN)
    found = em.solve(problem)
    again = em.solve(problem, initial=found.reference)
    assert again.mesh.distance(found.mesh) < 1e-3
    broken = em.Mesh(found.reference.x.copy(), found.reference.y.copy())
    broken.x[0, 3] += 1e-3
    with pytest.raises(em.InputError, match="valid one of the reference square"):
        em.solve(problem, initial=broken)
