"""Records of iterations: the estimate of the error, what meets a tolerance, the observed rate."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import equimesh as em
from equimesh.schwarz.records import estimate_error, observed_rate
from solver.schwarz.runs import PAPER


def test_estimate_by_hand() -> None:
    assert math.isnan(estimate_error([math.nan], 1e-15))
    assert math.isnan(estimate_error([math.nan, 0.1], 1e-15))
    assert estimate_error([math.nan, 0.0], 1e-15) == 0.0
    assert estimate_error([math.nan, 0.1, 0.09], 1e-15) == pytest.approx(0.09 * 9)
    assert estimate_error([math.nan, 0.1, 0.01, 0.001], 1e-15) == pytest.approx(0.001)  # never less than the change
    assert estimate_error([math.nan, 0.1, 0.2], 1e-15) == math.inf
    assert estimate_error([math.nan, 0.4, 0.0, 0.1], 1e-15) == pytest.approx(0.1)
    assert estimate_error([math.nan, 1e-3, 1e-16, 2e-16], 1e-15) == 2e-16
    assert estimate_error([math.nan, 0.0, 1e-3], 1e-15) == math.inf  # after an iteration in which all stalled
    assert estimate_error([math.nan, 0.0, 1e-3, 1e-4], 1e-15) == math.inf


def test_what_meets_a_tolerance() -> None:
    """Each of the demands by itself: a small estimate, agreement, no subdomain left unsolved, no fold."""
    settings = em.Schwarz(transmission=em.LinearRobin(), tolerance=1e-6)
    last = em.solve(PAPER, settings).iterations[-1]
    assert last.meets(1e-6)
    assert not last.meets(None)
    assert not replace(last, estimate=2e-6).meets(1e-6)
    assert not replace(last, estimate=math.nan).meets(1e-6)
    assert not replace(last, mismatch=3e-6).meets(1e-6)
    assert not replace(last, min_jacobian=0.0).meets(1e-6)
    first, *others = last.subdomains
    unsolved = replace(last, subdomains=(replace(first, stalled=True), *others))
    assert not unsolved.meets(1e-6)
    assert replace(unsolved, deviation=1e-8).meets(1e-6)  # the equations were tested on the whole mesh


def test_the_observed_rate_is_that_of_the_tail_above_rounding() -> None:
    errors = [math.nan, 0.5, *(0.1**k for k in range(1, 9)), 2e-14, 1e-14, 1e-14]
    assert observed_rate(errors, 1e-13) == pytest.approx(0.1)
    assert observed_rate(errors, 1e-16) != pytest.approx(0.1, rel=0.3)  # what rounding leaves says nothing of a rate
    assert observed_rate([math.nan, 1e-3], 1e-13) is None
    assert observed_rate([math.nan, 0.0, 0.0], 1e-13) is None
