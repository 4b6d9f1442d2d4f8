"""Error estimates on the safe side."""

from __future__ import annotations

import math

import error_estimates
import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.single_domain.iteration import single_domain_steps
from equimesh.solving.certificate import safe_algebraic_error, safe_discretization_error

SEED, COUNT = 7, 12  # of random problems


@pytest.mark.parametrize("safe", [safe_algebraic_error, safe_discretization_error])
def test_what_is_not_known_stays_unknown_and_what_is_exact_stays_exact(safe: object) -> None:
    assert [safe(value) for value in (None, math.nan, math.inf)] == [None, None, None]  # type: ignore[operator]
    assert safe(0.0) == 0.0  # type: ignore[operator]


def test_the_certificate_has_the_estimates_of_the_solve_and_a_margin() -> None:
    case = problem("paper", 33)
    *_, last = single_domain_steps(case, mode=em.Mode.DISCRETIZATION)
    certificate = em.solve(case).certificate
    for estimate, shown in (
        (last.algebraic_error, certificate.algebraic_error),
        (last.discretization_error, certificate.discretization_error),
    ):
        assert shown is not None
        assert 1.2 * estimate < shown < 3 * estimate


@pytest.fixture(scope="module")
def found() -> list[error_estimates.Ratios]:
    return list(error_estimates.ratios(SEED, COUNT))


@pytest.mark.parametrize("name", ["algebraic", "discretization"])
def test_estimates_err_on_the_safe_side(found: list[error_estimates.Ratios], name: str) -> None:
    assert len(found) == COUNT
    ratios = np.array([getattr(one, name) for one in found])
    known = ratios[np.isfinite(ratios)]
    assert known.size >= COUNT - 1
    assert np.mean(known <= 1.0) >= 0.9
    assert np.median(known) > 0.1  # and not by a wide margin
