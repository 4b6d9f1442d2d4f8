"""The choice for cell-centred codes: by their error, never worse than the uniform mesh, within its bound."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh import Mesh
from equimesh.quality.faces import check_cells, poisson_error
from equimesh.solving.finite_volumes import USUAL_BOUND


def gain(solution: em.Solution, u: em.Expression) -> float:
    uniform = map_mesh(Mesh.uniform(solution.problem.grid), solution.problem.domain)
    return poisson_error(uniform, u) / poisson_error(solution.mesh, u)


def chosen(text: str, n: int = 17, schwarz: em.Schwarz | None = None, **more: Any) -> em.Solution:
    domain = more.pop("domain", em.Rectangle())
    monitor = em.Auto(u=em.Expression(text), purpose="finite_volume", **more)
    return em.solve(em.Problem(monitor=monitor, grid=em.Grid(n_xi=n, n_eta=n), domain=domain), schwarz)


def test_a_front_gains_at_the_cell_centres() -> None:
    text = "tanh(12*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))"
    solution = chosen(text)
    assert gain(solution, em.Expression(text)) > 1.3
    assert solution.faces.non_orthogonality <= USUAL_BOUND
    assert check_cells(solution.mesh).passed
    first, *rest = solution.certificate.comparison
    assert [one.chosen for one in (first, *rest)] == [True, *[False] * len(rest)]
    assert first.gain_cells == pytest.approx(gain(solution, em.Expression(text)))
    assert {one.kind for one in (first, *rest)} == {"uniform", "least_error", "curvature", "arc_length"}
    assert "at cell centres" in str(solution.certificate)


def test_where_no_candidate_is_better_the_mesh_is_uniform() -> None:
    solution = chosen("x*x + y*y", n=9)
    assert gain(solution, em.Expression("x*x + y*y")) == 1.0
    assert np.array_equal(solution.mesh.x, Mesh.uniform(solution.problem.grid).x)
    assert solution.certificate.comparison[0].kind == "uniform"
    assert "uniform mesh" in solution.message


@pytest.mark.everything
def test_on_a_finer_grid_the_best_are_measured_there() -> None:
    text = "exp(-x/0.05) + exp(-y/0.05)"
    solution = chosen(text, n=41)
    assert gain(solution, em.Expression(text)) > 10.0
    assert solution.certificate.comparison[0].gain_cells == pytest.approx(gain(solution, em.Expression(text)))


@pytest.mark.everything
def test_a_given_bound_holds_and_a_bent_domain_is_measured_as_it_is() -> None:
    text = "tanh(9*(hypot(x, y) - 1.4 + 0.2*sin(3*x)))"
    solution = chosen(text, n=9, orthogonality=20.0, domain=em.AnnulusSector())
    assert solution.faces.non_orthogonality <= 20.0
    assert gain(solution, em.Expression(text)) > 1.0


def test_bad_input() -> None:
    with pytest.raises(em.InputError, match="'finite_volume'") as caught:
        em.Auto(u=em.Expression("x*y"), purpose="finite_elements")
    assert caught.value.field == "purpose"
    with pytest.raises(em.InputError, match="second derivatives of u are not finite"):
        chosen("log((x - 0.53125)**2 + (y - 0.53125)**2)")
