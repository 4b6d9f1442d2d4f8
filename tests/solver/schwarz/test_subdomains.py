"""Subdomains that exchange functionals: classical data where a condition has no solution."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import NewtonSolution
from equimesh.schwarz.subdomains import Outcome, SubdomainSweeps
from solver.schwarz.bent import bent, distance, yielding_subdomains
from solver.schwarz.runs import LINEAR_ROBIN


def test_robin_that_finds_no_solution_is_rescued_and_reported() -> None:
    """Linear Robin with p = auto has no solution on blocks of the paper's function in the first iteration."""
    solution = em.solve(problem("paper", 17), LINEAR_ROBIN)
    assert any(r.classical for r in solution.iterations[1].subdomains)
    assert "classical data took its place" in solution.message
    assert solution.iterations[-1].transmission == "optimized"  # which takes over where the other one stalls


# The equations of subdomains with the optimized condition: Newton's method finds what their sweeps converge to.


SECTOR = em.AnnulusSector(center=(0.0, -0.5), radii=(0.5, 1.5), angles=(20.0, 110.0))


def check_against_sweeps(case: em.Problem, parts: tuple[int, int], data: em.LineData = em.LineData.LINE_SUMS) -> None:
    """Newton's method finds what sweeps without end converge to, in every subdomain."""
    decomposition = em.Decomposition(grid=case.grid, subdomains=parts, overlap=3)
    mesh = bent(case, 0.01)
    found = yielding_subdomains(case, decomposition, em.Optimized(data=data))
    found.begin(mesh)
    for k, window in enumerate(found.windows):
        start, sides = found.received(k)
        sweeps = SubdomainSweeps(case, window.shape, window.frame(case.grid.shape))
        swept = sweeps.solve(window.restrict(mesh), sides.rest, accuracy=1e-14, most=400)
        newton = found.solve(k).solution
        assert newton.converged
        assert not newton.swept
        assert distance(newton.mesh, swept.mesh) < 1e-10
        assert distance(newton.mesh, start) > 1e-3


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("parts", [(3, 1), (1, 3), (3, 3)], ids=str)
def test_newton_finds_what_sweeps_converge_to(boundary: em.Boundary, parts: tuple[int, int]) -> None:
    check_against_sweeps(problem("paper", 18, 15, boundary=boundary), parts)


@pytest.mark.parametrize("data", em.LineData)
def test_newton_finds_what_sweeps_converge_to_on_a_domain(data: em.LineData) -> None:
    monitor = em.Weight(rho=em.Expression("1 + 2*exp(-10*((x - 0.4)**2 + (y - 0.6)**2))"))
    case = em.Problem(monitor=monitor, grid=em.Grid(n_xi=15, n_eta=18), domain=SECTOR)
    check_against_sweeps(case, (3, 3), data)


# Subdomains with the optimized condition: Newton's method where their sweeps fail.


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


# Outcomes of subdomain solves as records, and what is said of all subdomains together.


MESH = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))


@pytest.mark.parametrize("swept", [False, True])
def test_an_outcome_counts_newton_steps_or_sweeps(swept: bool) -> None:
    outcome = Outcome(NewtonSolution(MESH, 7, 1e-9, converged=True, swept=swept))
    record = outcome.record(3, None)
    assert (record.subdomain, record.residual, record.stalled, record.classical) == (3, 1e-9, False, False)
    assert (record.newton_steps, record.sweeps) == ((0, 7) if swept else (7, 0))


def test_two_solves_of_one_iteration_add_up_and_a_stall_is_not_forgotten() -> None:
    first = Outcome(NewtonSolution(MESH, 4, 1.0, converged=False), classical=True).record(1, None)
    both = Outcome(NewtonSolution(MESH, 5, 1e-9, converged=True, swept=True)).record(1, first)
    assert (both.newton_steps, both.sweeps, both.residual) == (4, 5, 1e-9)
    assert both.stalled
    assert both.classical
