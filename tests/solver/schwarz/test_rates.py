"""Predicted rates, against those that are observed."""

from __future__ import annotations

import math

import pytest

import equimesh as em
from cases import problem
from solver.schwarz.runs import PAPER


def test_classical_rate_is_the_predicted_one() -> None:
    """alpha (1 - beta) / (beta (1 - alpha)) for two strips and two parallel iterations."""
    settings = em.Schwarz(
        overlap=2,
        transmission=em.Classical(),
        ordering=em.Ordering.PARALLEL,
        compare_single_domain=True,
        tolerance=None,
        max_iterations=60,
    )
    case = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    solution = em.solve(case, settings, initial=em.Initial.UNIFORM)
    alpha, beta = 5 / 11, 6 / 11
    assert solution.predicted_rate == pytest.approx(math.sqrt(alpha * (1 - beta) / (beta * (1 - alpha))), abs=1e-12)
    assert solution.rate == pytest.approx(solution.predicted_rate, abs=0.005)


EVERY = [*em.Ordering]


@pytest.mark.parametrize(
    ("subdomains", "overlap", "ordering"),
    [
        *(((2, 1), 3, ordering) for ordering in EVERY[::2]),
        *(((3, 2), 4, ordering) for ordering in EVERY[1::2]),
        ((1, 3), 4, EVERY[0]),
        ((4, 1), 4, EVERY[1]),
        (((8, 17), (6,)), 4, EVERY[-1]),
    ],
    ids=str,
)
def test_predicted_rates_hold_for_strips_and_blocks(
    subdomains: tuple[int | tuple[int, ...], int | tuple[int, ...]], overlap: int, ordering: em.Ordering
) -> None:
    settings = em.Schwarz(
        subdomains=subdomains,
        overlap=overlap,
        transmission=em.Classical(),
        ordering=ordering,
        compare_single_domain=True,
        tolerance=1e-7,
        max_iterations=150,
    )
    solution = em.solve(PAPER, settings)
    assert solution.rate == pytest.approx(solution.predicted_rate, abs=0.01)
