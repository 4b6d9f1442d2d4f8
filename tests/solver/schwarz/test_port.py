"""Outcomes of subdomain solves as records, and what is said of all subdomains together."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.equations.newton_solve import NewtonSolution
from equimesh.schwarz.subdomains import Outcome
from solver.schwarz.solved import solved

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


@pytest.mark.parametrize("stalled", [False, True])
@pytest.mark.parametrize("classical", [False, True])
def test_one_subdomain_speaks_for_all(stalled: bool, classical: bool) -> None:
    found = solved(MESH, stalled=stalled, classical=classical)
    assert (found.has_stalled, found.is_rescued) == (stalled, classical)
