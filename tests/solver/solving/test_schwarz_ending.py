"""How a Schwarz iteration ended, from its records alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import equimesh as em
from cases import problem
from equimesh.schwarz.records import IterationNumbers, SubdomainRecord
from equimesh.solving.schwarz import SchwarzEnding, ending_of

CASE = problem("paper", 17)
SOLVED = SubdomainRecord(subdomain=0, newton_steps=2, sweeps=3, residual=1e-9)
LAST = IterationNumbers(
    iteration=2,
    problem=CASE,
    min_jacobian=0.5,
    change=1e-6,
    estimate=1e-7,
    mismatch=1e-8,
    subdomains=(SOLVED, replace(SOLVED, subdomain=1, residual=1e-8)),
    transmission="optimized",
)


def ended(tolerance: float | None, *, folded: bool = False, **last: Any) -> SchwarzEnding:
    records = [replace(LAST, iteration=1, change=1e-3), replace(LAST, **last)]
    return ending_of(CASE, em.Schwarz(), records, tolerance, nested=True, folded=folded)


def test_it_converged() -> None:
    end = ended(1e-6)
    assert (end.status, end.note, end.remedy, end.detours) == (em.Status.CONVERGED, "", "", ())
    assert (end.newton_steps, end.residual, end.algebraic_error) == (2 * 2 * 5, 1e-8, 1e-7)
    assert "Rounding allows no tolerance below" in ended(1e-20, estimate=1e-14, mismatch=0.0).note


@pytest.mark.parametrize(
    ("last", "tolerance", "status", "note"),
    [
        ({}, None, em.Status.COMPLETED, ""),
        ({}, 1e-9, em.Status.NOT_CONVERGED, "the estimated error is 1.0e-07, and the subdomains differ by 1.0e-08"),
        ({"failed": True}, 1e-6, em.Status.NEWTON_FAILED, "In iteration 2 the iteration stalled for good."),
        ({"folded": True}, 1e-6, em.Status.FOLDED, ""),
        ({"transmission": "classical"}, 1e-6, em.Status.CONVERGED, "from iteration 2 on the classical one took"),
        ({"global_step": True}, 1e-6, em.Status.CONVERGED, "In iteration 2 a Newton step was taken"),
    ],
)
def test_other_ends_are_said(last: dict[str, Any], tolerance: float | None, status: em.Status, note: str) -> None:
    end = ended(tolerance, **last)
    assert end.status is status
    assert note in end.note
    assert bool(end.remedy) == (status not in {em.Status.CONVERGED, em.Status.COMPLETED})
