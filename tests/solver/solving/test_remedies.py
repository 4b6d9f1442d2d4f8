"""Remedies: what a failed solve offers fits the case, and is nothing that it had tried already."""

from __future__ import annotations

from dataclasses import replace

import pytest

import equimesh as em
from cases import problem
from equimesh.equations.newton_solve import smallest_tolerance
from equimesh.solving import status

PAPER = problem("paper", 24, 20)
CLASSICAL = em.Schwarz(transmission=em.Classical(), ordering=em.Ordering.ALTERNATING, max_iterations=6)


def remedy(settings: em.Schwarz | None, case: em.Problem = PAPER, initial: em.Initial = em.Initial.NESTED) -> str:
    solution = em.solve(case, settings, initial=initial, allow_relaxed=False, check=False)
    assert not solution.status.succeeded
    assert solution.message.endswith(solution.remedy)
    return solution.remedy


def test_a_slow_iteration_is_told_how_many_more_it_needs() -> None:
    said = remedy(CLASSICAL)
    more = int(said.partition("about ")[2].partition(" ")[0])
    longer = em.solve(PAPER, replace(CLASSICAL, max_iterations=6 + 2 * more))
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
    last = em.solve(PAPER, CLASSICAL, check=False).iterations[-1]
    said = status.after_schwarz(PAPER, CLASSICAL, last, 1.2, 1e-10)
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
    assert "trace" not in status.after_newton(PAPER, nested=True, reached=0.1)


def test_other_monitors_are_not_told_of_a() -> None:
    case = replace(PAPER, monitor=em.Weight(rho=em.Expression("1 + x")))
    assert status.after_newton(case, nested=True, reached=0.5) == "Smooth the monitor, or add grid points."


def test_where_nothing_helps_a_jump_is_suspected() -> None:
    said = status.after_newton(PAPER, nested=True, reached=0.0)
    assert said.startswith("Replace a jump of u")
    assert "ower a to" not in said


def test_a_folded_mesh_is_offered_iterations_only_where_their_number_was_fixed() -> None:
    fixed = replace(CLASSICAL, tolerance=None)
    assert "more iterations" in status.after_folding(PAPER, fixed, nested=True)
    assert (
        status.after_folding(PAPER, CLASSICAL, nested=False) == "Lower a, raise b, smooth the monitor, or start nested."
    )


@pytest.mark.parametrize("condition", [em.Classical(), em.LinearRobin()], ids=lambda c: c.name)
def test_a_tolerance_below_rounding_is_met_as_far_as_it_can_be_and_said(condition: em.TransmissionCondition) -> None:
    settings = em.Schwarz(overlap=8, transmission=condition, tolerance=1e-300, compare_single_domain=True)
    solution = em.solve(PAPER, settings)
    error = solution.iterations[-1].error
    assert error is not None
    assert error < 2 * smallest_tolerance(PAPER)
    assert "Rounding allows no tolerance below 2e-12" in solution.message
    assert "Rounding" not in em.solve(PAPER, replace(settings, tolerance=1e-6)).message
