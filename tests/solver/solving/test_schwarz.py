"""Endings of solves: the status, the message, and the remedies of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.schwarz.records import IterationNumbers, SubdomainRecord
from equimesh.solving import status
from equimesh.solving.schwarz import SchwarzEnding, ending_of
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
    settings = em.Schwarz(overlap=2, transmission=em.Classical(), max_iterations=12)
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


def test_a_newton_failure_says_where_and_folds_nothing() -> None:
    hopeless = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)
    with pytest.raises(em.SolveError, match="and a cross-line term") as caught:
        em.solve(hopeless, allow_relaxed=False)
    assert caught.value.solution.status is em.Status.NEWTON_FAILED
    assert not caught.value.solution.mesh.is_folded


GIVEN = problem("paper", 24, 20)
CLASSICAL = em.Schwarz(transmission=em.Classical(), ordering=em.Ordering.ALTERNATING, max_iterations=6)


def remedy(settings: em.Schwarz | None, case: em.Problem = GIVEN, initial: em.Initial = em.Initial.NESTED) -> str:
    solution = em.solve(case, settings, initial=initial, allow_relaxed=False, check=False)
    assert not solution.status.succeeded
    assert solution.message.endswith(solution.remedy)
    return solution.remedy


def test_a_slow_iteration_is_told_how_many_more_it_needs() -> None:
    said = remedy(CLASSICAL)
    more = int(said.partition("about ")[2].partition(" ")[0])
    longer = em.solve(GIVEN, replace(CLASSICAL, max_iterations=6 + 2 * more))
    assert 0.5 * more < longer.iterations[-1].iteration - 6 < 2 * more
    assert "widen the overlap, to 8 points" in said
    assert "use the optimized transmission condition, allow line corrections" in said


def test_only_what_fits_and_was_not_tried_is_offered() -> None:
    assert "overlap" not in remedy(replace(CLASSICAL, overlap=13, max_iterations=3))
    bare = em.Schwarz(line_correction=0, acceleration=em.Acceleration.NONE, max_iterations=2)
    assert "allow line corrections" in remedy(bare)
    assert "optimized" not in remedy(bare)
    assert "line corrections" not in remedy(em.Schwarz(max_iterations=1))


def test_an_iteration_that_does_not_shrink_is_not_sent_on() -> None:
    last = em.solve(GIVEN, CLASSICAL, check=False).iterations[-1]
    said = status.after_schwarz(GIVEN, CLASSICAL, last, 1.2, 1e-10)
    assert "more iterations" not in said
    assert "single domain" in said


def test_newton_is_offered_the_strength_that_was_reached() -> None:
    case = problem("wave", 9, boundary=em.Boundary.EQUIDISTRIBUTED_1D, a=1.0, b=0.0)
    solution = em.solve(case, allow_relaxed=False, check=False)
    assert solution.status is em.Status.NEWTON_FAILED
    reached = {relaxed.what: relaxed.reached for relaxed in solution.relaxed}["a"]
    assert solution.remedy.startswith(f"Lower a to {reached:.2g} or less, raise b, smooth the monitor, add grid points")
    assert "trace boundary" in solution.remedy
    assert "nested" not in solution.remedy
    assert "start nested" in remedy(None, case, em.Initial.UNIFORM)
    assert "trace" not in status.after_newton(GIVEN, nested=True, reached=0.1)


def test_other_monitors_are_not_told_of_a() -> None:
    case = replace(GIVEN, monitor=em.Weight(rho=em.Expression("1 + x")))
    assert status.after_newton(case, nested=True, reached=0.5) == "Smooth the monitor, or add grid points."


def test_where_nothing_helps_a_jump_is_suspected() -> None:
    said = status.after_newton(GIVEN, nested=True, reached=0.0)
    assert said.startswith("Replace a jump of u")
    assert "ower a to" not in said


def test_a_folded_mesh_is_offered_iterations_only_where_their_number_was_fixed() -> None:
    fixed = replace(CLASSICAL, tolerance=None)
    assert "more iterations" in status.after_folding(GIVEN, fixed, nested=True)
    assert (
        status.after_folding(GIVEN, CLASSICAL, nested=False) == "Lower a, raise b, smooth the monitor, or start nested."
    )


@pytest.mark.parametrize("condition", [em.Classical(), em.LinearRobin()], ids=lambda c: c.name)
def test_a_tolerance_below_rounding_is_met_as_far_as_it_can_be_and_said(condition: em.TransmissionCondition) -> None:
    settings = em.Schwarz(overlap=8, transmission=condition, tolerance=1e-300, compare_single_domain=True)
    solution = em.solve(GIVEN, settings)
    error = solution.iterations[-1].error
    assert error < 2 * smallest_tolerance(GIVEN)
    assert "Rounding allows no tolerance below 2e-12" in solution.message
    assert "Rounding" not in em.solve(GIVEN, replace(settings, tolerance=1e-6)).message
