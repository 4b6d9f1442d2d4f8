"""Schwarz solves: their endings, with the status and the message of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from cases import problem
from solver.schwarz.runs import HOPELESS, PAPER, assert_same


def test_not_converged_says_so_and_keeps_what_there_is() -> None:
    settings = em.Schwarz(transmission=em.Classical(), max_iterations=3)
    with pytest.raises(em.SolveError, match="within the allowed iterations") as caught:
        em.solve(PAPER, settings)
    partial = caught.value.solution
    assert partial.status is em.Status.NOT_CONVERGED
    assert len(partial.iterations) == 4
    assert not partial.mesh.is_folded


def test_a_fixed_number_of_iterations_is_a_success() -> None:
    settings = em.Schwarz(transmission=em.Classical(), tolerance=None, max_iterations=3)
    solution = em.solve(PAPER, settings)
    assert (solution.status, len(solution.iterations)) == (em.Status.COMPLETED, 4)


def test_a_folded_mesh_is_never_a_success(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the asked number of iterations was run; the merged mesh of good subdomains is made to fold here."""
    settings = em.Schwarz(tolerance=None, max_iterations=1)

    def folding(*arguments: object, threads: int) -> Iterator[em.Iteration]:
        for record in em.iterate(*arguments, threads=threads):  # type: ignore[arg-type]
            yield replace(record, mesh=em.Mesh(record.mesh.x[::-1].copy(), record.mesh.y))

    monkeypatch.setattr("equimesh.solving.schwarz.schwarz_iterations", folding)
    with pytest.raises(em.SolveError, match=r"inverted cell\. Run more iterations, lower a") as caught:
        em.solve(PAPER, settings)
    assert caught.value.solution.status is em.Status.FOLDED


def test_where_no_iteration_leads_to_a_mesh_a_single_domain_does() -> None:
    settings = em.Schwarz(overlap=2, transmission=em.Classical(), max_iterations=40)
    solution = em.solve(HOPELESS, settings)
    single = em.solve(HOPELESS, mode=em.Mode.TIGHT)
    assert solution.status is single.status is em.Status.RELAXED
    assert np.array_equal(solution.mesh.x, single.mesh.x)
    names = [record.transmission for record in solution.iterations]
    assert names == ["classical"] * 4 + ["optimized"] * (len(names) - 4)
    assert solution.iterations[-1].failed
    assert "this is the mesh of a single domain" in solution.message
    assert any("of a single domain" in warning for warning in solution.certificate.warnings)
    with pytest.raises(em.SolveError, match="of a single domain"):
        em.solve(HOPELESS, settings, allow_relaxed=False)


def test_one_subdomain_is_the_single_domain_solve() -> None:
    solution = em.solve(PAPER, em.Schwarz(subdomains=(1, 1)))
    single = em.solve(PAPER, mode=em.Mode.TIGHT).mesh
    assert abs(solution.mesh.x - single.x).max() < 1e-10  # the single-domain solve ends there
    assert len(solution.iterations) - 1 <= 3


@pytest.mark.parametrize("n", [17, 33, 65])
def test_to_the_error_of_the_discretization(n: int) -> None:
    case = problem("tanh20", n)
    solution = em.solve(case, em.Schwarz(subdomains=(2, 2), tolerance="discretization"))
    tight = em.solve(case, mode=em.Mode.TIGHT)
    assert solution.discretization_error is not None
    assert len(solution.iterations) - 1 <= 2
    assert_same(solution, tight, 0.25 * solution.discretization_error)
