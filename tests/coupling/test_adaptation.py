"""The records of a loop that adapts."""

from __future__ import annotations

import json

import numpy as np
import pytest

import equimesh as em
from equimesh_coupling.adaptation import ended, verdict_on

MESH = em.Mesh.uniform(em.Grid(n_xi=4, n_eta=5))


def record(number: int, estimate: float, unresolved: float | None = None) -> em.AdaptRound:
    values = np.full((4, 5), float(number))
    return em.AdaptRound(number=number, mesh=MESH, values=values, estimate=estimate, unresolved=unresolved)


def test_the_result_is_that_of_the_best_round() -> None:
    done = (record(0, 3.0), record(1, 1.0), record(2, 2.0))
    found = em.Adaptation(rounds=done, best=1, resolved=True, reason="It ended.")
    assert found.mesh is done[1].mesh
    assert found.values is done[1].values
    assert found.estimate == 1.0
    assert found.failure is None
    assert repr(found) == "<Adaptation: round 1 of 2, estimate 1, resolved>"


@pytest.mark.parametrize("estimate", [0.5, float("nan")])
def test_the_numbers_of_a_round_are_ready_for_json(estimate: float) -> None:
    numbers = json.loads(json.dumps(record(2, estimate).numbers(), allow_nan=False))
    assert numbers["number"] == 2
    assert numbers["start"] == "given"
    assert numbers["estimate"] == (0.5 if estimate == 0.5 else None)
    assert numbers["unresolved"] is None


def test_a_failure_keeps_the_best_round_and_is_told() -> None:
    found = ended([record(0, 3.0), record(1, 1.0)], 5, "l2", ValueError("the solver diverged"))
    assert (found.best, found.estimate) == (1, 1.0)
    assert found.reason == "Round 2 failed, and the best mesh before it is kept: ValueError: the solver diverged"
    assert isinstance(found.failure, ValueError)


def test_the_verdict_is_that_on_the_numbers() -> None:
    assert not verdict_on([record(0, 3.0), record(1, 1.0)], 5, "l2").is_done
    assert verdict_on([record(0, 3.0), record(1, 1.0)], 1, "l2").is_done


def test_the_requested_norm_ranks_the_rounds_and_ends_the_loop() -> None:
    done = [record(0, 3.0, 0.3), record(1, 2.0, 0.05), record(2, 1.0, 0.06), record(3, 0.5, 0.07)]
    assert (ended(done, 5, "l2").best, ended(done, 5, "h1").best) == (3, 1)
    assert not verdict_on(done, 5, "l2").is_done
    assert "stands still" in verdict_on(done, 5, "h1").reason


def test_an_indicator_and_an_exact_solution_rank_by_their_estimate_in_every_norm() -> None:
    assert ended([record(0, 3.0), record(1, 1.0)], 5, "h1").best == 1
    exact = verdict_on([record(0, 0.0, 1e-16)], 5, "h1")
    assert (exact.is_done, exact.best) == (True, 0)
