"""The decisions of a loop that adapts, from numbers alone."""

from __future__ import annotations

import pytest

from equimesh_coupling.adaptation import RoundNumbers, judge


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


def test_a_rise_is_told() -> None:
    history = [RoundNumbers(estimate=one, unresolved=0.5) for one in (1e-9, 1e-5, 1e-4)]
    verdict = judge(history, 5)
    assert verdict.reason == (
        "The estimate rose in the last 2 rounds: their meshes saw more of the solution than those before."
    )
    assert (verdict.best, verdict.resolved) == (0, False)
