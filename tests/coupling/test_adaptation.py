"""The records of a loop that adapts."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh_coupling.adaptation import GoalRecord, RoundNumbers, ended, judge, verdict_on, wanted_density

MESH = em.Mesh.uniform(em.Grid(n_xi=4, n_eta=5))


def record(number: int, estimate: float, unresolved: float | None = None, gradient: float = 1.0) -> em.AdaptRound:
    values = np.full((4, 5), float(number))
    slopes = None if unresolved is None else unresolved * gradient
    return em.AdaptRound(
        number=number, mesh=MESH, values=values, estimate=estimate, estimate_h1=slopes, unresolved=unresolved
    )


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


def test_an_error_of_zero_is_resolved_where_rounding_is_all_of_the_gradient() -> None:
    assert verdict_on([record(0, 0.0, 0.9)], 5, "l2").resolved


def test_the_requested_norm_ranks_the_rounds_and_ends_the_loop() -> None:
    done = [record(0, 3.0, 0.3), record(1, 2.0, 0.05), record(2, 1.0, 0.06), record(3, 0.5, 0.07)]
    assert (ended(done, 5, "l2").best, ended(done, 5, "h1").best) == (3, 1)
    assert not verdict_on(done, 5, "l2").is_done
    assert "stands still" in verdict_on(done, 5, "h1").reason


def test_an_indicator_and_an_exact_solution_rank_by_their_estimate_in_every_norm() -> None:
    assert ended([record(0, 3.0), record(1, 1.0)], 5, "h1").best == 1
    exact = verdict_on([record(0, 0.0, 1e-16)], 5, "h1")
    assert (exact.is_done, exact.best) == (True, 0)


# The wanted density of cells, from an error indicator.


AXES = np.meshgrid(*[np.linspace(0.0, 1.0, 9)] * 2, indexing="ij")


def test_the_density_has_the_power_of_the_norm() -> None:
    indicator = np.ones((8, 8))
    indicator[4:] = 8.0
    for norm, ratio in (("l2", 4.0), ("h1", 8.0)):
        density = wanted_density(*AXES, indicator, norm)
        low, high = density[0, 0], density[-1, -1]
        mean = 0.5 * (1.0 + ratio)
        assert high / low == pytest.approx((ratio / mean + 0.1) / (1.0 / mean + 0.1))


def test_equal_indicators_on_a_graded_mesh_keep_its_density() -> None:
    x = np.linspace(0.0, 1.0, 9) ** 2
    graded = np.meshgrid(x, np.linspace(0.0, 1.0, 9), indexing="ij")
    density = wanted_density(*graded, np.ones((8, 8)), "l2")
    assert np.all(np.diff(density[:, 0]) <= 1e-12)
    assert density[0, 0] > 5.0 * density[-1, 0]


def test_no_density_where_all_indicators_are_zero() -> None:
    assert wanted_density(*AXES, np.zeros((8, 8)), "l2") is None


# The decisions of a loop that adapts, from numbers alone.


def history(*estimates: float, unresolved: float | None = 0.05, moved: float = 0.0) -> list[RoundNumbers]:
    return [RoundNumbers(estimate=one, unresolved=unresolved, moved_cells=moved) for one in estimates]


def test_the_best_round_has_the_smallest_estimate_and_is_the_first_of_equal_ones() -> None:
    assert judge(history(4.0, 2.0, 3.0), 5).best == 1
    assert judge(history(4.0, 2.0, 2.0), 5).best == 1
    assert judge(history(4.0), 5).best == 0


@pytest.mark.parametrize(
    ("estimates", "is_done"),
    [
        ((8.0,), False),
        ((8.0, 4.0), False),
        ((8.0, 7.0), False),  # one round in vain is allowed
        ((8.0, 7.0, 6.9), True),
        ((8.0, 7.0, 6.7), False),  # 16 % in two rounds
        ((8.0, 9.0, 7.0), True),
        ((8.0, 9.0, 4.0, 3.9), False),
        ((8.0, 4.0, 3.9, 3.8), True),
        ((8.0, 4.0, 2.0, 1.0, 0.5), False),
    ],
)
def test_it_ends_after_two_rounds_without_15_percent(estimates: tuple[float, ...], is_done: bool) -> None:
    verdict = judge(history(*estimates), 5)
    assert verdict.is_done is is_done
    assert verdict.reason == (
        "The estimate stands still: it did not fall by 15% in the last 2 rounds." if is_done else ""
    )


def test_it_ends_after_the_rounds_that_are_allowed() -> None:
    falling = judge(history(8.0, 4.0, 2.0), 2)
    assert falling.is_done
    assert falling.reason == "It ended after 2 rounds, the most that was allowed; the estimate was still falling."
    assert "1 round, the most that was allowed; the last one brought little." in judge(history(8.0, 7.9), 1).reason
    assert not judge(history(8.0, 4.0, 2.0), 3).is_done


def test_it_ends_where_the_solution_is_exact() -> None:
    verdict = judge(history(0.0, unresolved=0.0), 5)
    assert (verdict.is_done, verdict.best, verdict.resolved) == (True, 0, True)
    assert "zero" in verdict.reason


def test_the_share_of_the_gradient_says_whether_layers_are_resolved() -> None:
    assert judge(history(4.0, 1.0, unresolved=0.15), 5).resolved
    assert not judge(history(4.0, 1.0, unresolved=0.16), 5).resolved
    mixed = [*history(4.0, unresolved=0.05), *history(1.0, unresolved=0.3)]
    assert not judge(mixed, 5).resolved  # the best round counts


def test_without_that_share_the_estimate_has_to_fall_while_the_mesh_moves() -> None:
    assert not judge(history(4.0, 3.0, unresolved=None, moved=2.0), 5).resolved
    assert judge(history(4.0, 2.0, unresolved=None, moved=2.0), 5).resolved
    assert judge(history(4.0, 3.0, unresolved=None, moved=0.5), 5).resolved


def test_an_indicator_of_one_mesh_resolves_nothing() -> None:
    assert not judge([RoundNumbers(estimate=1.0)], 5).resolved
    assert judge([RoundNumbers(estimate=0.0)], 5).resolved


def test_what_another_mesh_sees_of_the_gradient_is_an_error_of_those_that_do_not() -> None:
    blind, half, seeing = ((1e-6, 0.05, 0.1), (1e-5, 0.25, 2.0), (1e-6, 0.14, 10.0))
    done = [record(0, *blind), record(1, *half)]
    for norm in ("l2", "h1"):
        verdict = verdict_on(done, 5, norm)
        assert (verdict.best, verdict.is_done, verdict.resolved) == (1, False, False)
        assert verdict_on([*done, record(2, *seeing)], 5, norm).best == 2


def test_an_oscillation_from_node_to_node_is_not_taken_for_a_gradient() -> None:
    done = [record(0, 1.0, 0.4, 10.0), record(1, 0.1, 0.05, 3.0), record(2, 0.05, 0.03, 2.99)]
    assert [verdict_on(done, 5, norm).best for norm in ("l2", "h1")] == [2, 2]


def test_it_goes_on_while_nothing_is_resolved_and_the_mesh_moves() -> None:
    assert not judge(history(4.0, 4.0, 4.0, unresolved=0.3, moved=1.0), 5).is_done
    assert judge(history(4.0, 4.0, 4.0, unresolved=0.3, moved=0.0), 5).is_done
    assert judge(history(4.0, 4.0, 4.0, unresolved=0.1, moved=1.0), 5).is_done


def test_the_error_of_the_gradient_has_to_fall_by_less() -> None:
    done = [record(0, 1.0, 0.1), record(1, 1.0, 0.09), record(2, 1.0, 0.081)]
    assert not verdict_on(done, 5, "h1").is_done
    assert verdict_on(done, 5, "l2").is_done


@pytest.mark.parametrize(("has_goal", "best"), [(True, 1), (False, 0)])
def test_rounds_for_a_goal_are_ranked_by_products_though_the_gradient_of_the_adjoint_falls(
    has_goal: bool, best: int
) -> None:
    done = [
        RoundNumbers(
            estimate=1.0,
            estimate_h1=slopes,
            unresolved=share,
            moved_cells=1.0,
            goal=GoalRecord(value=1.0, error=None, bound=slopes**2) if has_goal else None,
        )
        for slopes, share in ((0.0096, 0.0197), (0.0048, 0.0101))
    ]
    assert judge(done, 5, "h1").best == best


def goal_rounds(values: Any, errors: Any, unresolved: Any, bounds: Any) -> list[RoundNumbers]:
    return [
        RoundNumbers(
            estimate=1.0,
            estimate_h1=bound**0.5,
            unresolved=share,
            moved_cells=1.0,
            goal=GoalRecord(value=value, error=error, bound=bound),
        )
        for value, error, share, bound in zip(values, errors, unresolved, bounds, strict=True)
    ]


@pytest.mark.parametrize(
    ("errors", "unresolved", "best"),
    [
        ((3e-5, -1e-8, 8e-6), (0.02, 0.02, 0.02), 2),
        ((3e-5, None, 8e-6), (0.02, 0.02, 0.02), 2),
        ((3e-5, 1e-6, 8e-6), (0.02, 0.02, 0.3), 1),
        ((3e-5, 1e-6, -6e-5), (0.02, 0.02, 0.02), 1),
    ],
    ids=["not by chance", "one without an error", "of those that resolve", "by an error above the bound"],
)
def test_rounds_for_a_goal_are_ranked_by_the_largest_error_of_the_functional(
    errors: tuple[float | None, ...], unresolved: tuple[float, ...], best: int
) -> None:
    done = goal_rounds((1.0, 1.0, 1.0), errors, unresolved, (9e-5, 4e-5, 3e-5))
    assert judge(done, 5, "h1").best == best


@pytest.mark.parametrize(
    ("values", "errors", "unresolved", "is_done"),
    [
        ((1.0, 1.1), (0.2, 0.1), (0.1, 0.1), True),
        ((1.0, 1.1), (0.2, 0.06), (0.1, 0.1), True),
        ((1.0, 1.1), (0.3, 0.0), (0.1, 0.1), False),
        ((1.0, 1.1), (0.2, 0.1), (0.3, 0.1), False),
        ((1.0, 1.1), (None, 0.1), (0.1, 0.1), False),
        ((1.1,), (0.0,), (0.1,), False),
    ],
    ids=["alike", "near", "error zero by chance", "not resolved before", "not known before", "one mesh"],
)
def test_a_functional_is_within_its_tolerance_on_two_meshes(
    values: Any, errors: Any, unresolved: Any, *, is_done: bool
) -> None:
    verdict = judge(goal_rounds(values, errors, unresolved, [1.0] * len(values)), 5, "h1", 0.1001)
    assert (verdict.is_done, "within the tolerance" in verdict.reason) == (is_done, is_done)
