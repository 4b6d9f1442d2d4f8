"""Paper: every figure of Table 1 of Haynes and Howse, to all printed digits."""

from __future__ import annotations

import pytest

import equimesh as em
from cases import problem

SINGLE_DOMAIN = "1.1979"
CLASSICAL = em.Schwarz(
    overlap=2, transmission=em.Classical(), ordering=em.Ordering.PARALLEL, tolerance=None, max_iterations=5
)
ROBIN = {"overlap": 2, "ordering": em.Ordering.ALTERNATING, "tolerance": None, "max_iterations": 5}
TABLE = [
    (CLASSICAL, "1.6375 1.3630 1.3629 1.3178 1.3136 1.2795"),
    (em.Schwarz(transmission=em.LinearRobin(p=2.3), **ROBIN), "1.6375 2.0076 1.1979 1.1979 1.1979 1.1979"),
    (em.Schwarz(transmission=em.NonlinearRobin(p=2.3), **ROBIN), "1.6375 2.0114 1.1979 1.1979 1.1979 1.1979"),
]
PAPER = problem("paper", 12, boundary=em.Boundary.EQUIDISTRIBUTED_1D)


@pytest.mark.parametrize(("settings", "printed"), TABLE, ids=[s.transmission.name for s, _ in TABLE])
def test_table_1(settings: em.Schwarz, printed: str) -> None:
    solution = em.solve(PAPER, settings, initial=em.Initial.UNIFORM)
    assert " ".join(f"{record.max_q_eq:.4f}" for record in solution.iterations) == printed
    assert solution.status is em.Status.COMPLETED


def test_table_1_single_domain() -> None:
    solution = em.solve(PAPER, initial=em.Initial.UNIFORM)
    assert f"{solution.quality.q_eq.max:.4f}" == SINGLE_DOMAIN
    assert solution.newton_steps == 6


def test_the_robin_parameter_of_the_paper_is_the_reciprocal_distance() -> None:
    """The paper found p = 2 best among integers; the closed form gives 11/5 for its interfaces at 6/11 and 5/11."""
    errors = {}
    for p in (1.0, 2.0, 11 / 5, 3.0):
        settings = em.Schwarz(transmission=em.LinearRobin(p=p), compare_single_domain=True, **ROBIN)
        solution = em.solve(PAPER, settings, initial=em.Initial.UNIFORM)
        errors[p] = solution.iterations[3].error
    assert min(errors, key=lambda p: errors[p]) == 11 / 5
    assert errors[2.0] < min(errors[1.0], errors[3.0])
    automatic = em.solve(
        PAPER,
        em.Schwarz(transmission=em.LinearRobin(), compare_single_domain=True, **ROBIN),
        initial=em.Initial.UNIFORM,
    )
    assert automatic.iterations[3].error == pytest.approx(errors[11 / 5], rel=1e-6)
