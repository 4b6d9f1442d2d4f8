"""Slow claims are believed where a Newton step on the whole grid agrees with them."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.schwarz import iteration
from equimesh.schwarz.iteration import Claim
from solver.schwarz.bent import bent, distance
from solver.schwarz.runs import PAPER, WHOLE

SOLUTION = bent(PAPER, 0.0)


def claim(size: float) -> Claim:
    return Claim(bent(PAPER, size), estimate=1e-9, change=1e-10, before=em.Mesh.uniform(PAPER.grid))


def test_a_true_claim_is_confirmed_with_what_the_step_still_moved() -> None:
    made = claim(1e-7)
    found = iteration.examine(PAPER, WHOLE, made, 1e-5)
    assert not found.is_refuted
    assert found.mesh is made.mesh
    assert found.change == made.change
    assert found.estimate == pytest.approx(distance(made.mesh, SOLUTION), rel=0.01)


def test_a_false_claim_is_refuted_and_the_step_is_where_it_continues() -> None:
    made = claim(1e-3)
    found = iteration.examine(PAPER, WHOLE, made, 1e-5)
    assert found.is_refuted
    assert distance(found.mesh, SOLUTION) < 0.1 * distance(made.mesh, SOLUTION)
    assert found.estimate == pytest.approx(distance(made.mesh, found.mesh))
    assert found.change == pytest.approx(distance(found.mesh, made.before))


def test_a_claim_is_never_made_bolder() -> None:
    made = Claim(SOLUTION, estimate=1e-6, change=1e-7, before=SOLUTION)
    assert iteration.examine(PAPER, WHOLE, made, 1e-5).estimate == 1e-6
