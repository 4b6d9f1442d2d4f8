"""What is measured after a solve: for a solution, and for the rows that a process holds."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import MeshRows
from equimesh.solving.solution import MeasuredMesh

U = em.Expression("tanh(9*(x + y/2 - 0.7))")


def measured(solution: em.Solution, **more: object) -> MeasuredMesh:
    windows = MeshRows.of(solution.mesh), MeshRows.of(solution.reference)
    return MeasuredMesh(problem=solution.problem, mesh=windows[0], reference=windows[1], **more)  # type: ignore[arg-type]


def solved(monitor: em.Monitor, domain: em.Domain | None = None) -> em.Solution:
    grid = em.Grid(n_xi=21, n_eta=17)
    return em.solve(em.Problem(monitor=monitor, grid=grid, domain=domain or em.Rectangle()))


@pytest.mark.parametrize("domain", [em.Rectangle(), em.AnnulusSector()], ids=["square", "sector"])
def test_a_certificate_says_what_is_measured(domain: em.Domain) -> None:
    solution = solved(em.ArcLength(u=U), domain)
    found, certificate = measured(solution), solution.certificate
    assert found.quality().summary() == solution.quality.summary()
    assert found.faces() == certificate.faces
    assert found.min_jacobian() == certificate.min_jacobian
    assert found.deviation(1.0) == pytest.approx(certificate.equation_residual, rel=1e-6)
    errors = solution.interpolation
    assert found.warnings(solution.status, (), errors, found.faces(), found.gains(errors)) == certificate.warnings


def test_known_values_of_u_are_not_evaluated_again() -> None:
    solution, asked = solved(em.ArcLength(u=U)), []

    def values() -> np.ndarray | None:
        asked.append(True)
        return solution.u

    known = measured(solution, u=values)
    assert known.deviation(1.0) == solution.certificate.equation_residual
    assert known.quality(solution.u).summary() == solution.quality.summary()
    known.faces()
    assert len(asked) == 1


@pytest.mark.parametrize("points", [17, 141])
def test_u_at_the_nodes_is_that_of_the_measures(points: int) -> None:
    """On a large mesh it was evaluated with the metric, on a small one with the errors."""
    problem = em.Problem(monitor=em.ArcLength(u=U), grid=em.Grid(n_xi=points, n_eta=points))
    first, second = em.solve(problem), em.solve(problem)
    assert first.quality.u is not None
    assert np.shares_memory(first.u, first.quality.u)
    assert second.u == pytest.approx(first.u, rel=1e-14)
    assert second.quality.summary() == first.quality.summary()
    assert first.quality.without_cells().u is None


def test_only_equidistribution_along_lines_has_a_deviation() -> None:
    least = solved(em.LeastError(u=U))
    assert measured(least).deviation(0.5) is None
    assert least.certificate.equation_residual is None
    mapped = solved(em.Weight(rho=em.Expression("1 + x*y"), map="gradient"))
    assert measured(mapped).deviation(0.5) == 0.5
    assert mapped.certificate.equation_residual == mapped.residual
