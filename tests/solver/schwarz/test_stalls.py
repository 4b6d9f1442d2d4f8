"""What says that an iteration leads nowhere: repeated rescues, false fixed points, and changes that fall too slowly."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

import equimesh as em
from equimesh.schwarz.iteration import Rescue, Stalls
from solver.schwarz.runs import PAPER, WHOLE
from solver.schwarz.solved import solved

MESH = em.Mesh.uniform(PAPER.grid)
ROBIN, CLASSICAL = em.LinearRobin(), em.Classical()


def calls(
    changes: Sequence[float],
    *,
    transmission: em.TransmissionCondition = ROBIN,
    rescued: int = 0,
    mismatch: float = 0.0,
    fallback: bool = True,
    rescue: Rescue | None = None,
) -> bool:
    """Whether another condition is called for after these changes, the first ``rescued`` with classical data."""
    stalls = Stalls(em.Schwarz(transmission=transmission, fallback=fallback), 1e-14)
    for k, change in enumerate(changes):
        stalls.note(solved(MESH, classical=k < rescued, mismatch=mismatch), change, 0.0)
    return stalls.call_for_another_condition(rescue or Rescue(PAPER, WHOLE))


def falling(factor: float, count: int) -> list[float]:
    return [0.1 * factor**k for k in range(count)]


def test_an_iteration_that_converges_calls_for_nothing() -> None:
    assert not calls([])
    assert not calls(falling(0.3, 20))
    assert not calls(falling(1.0, 8)), "too few to be sure"


def test_changes_that_fall_too_slowly() -> None:
    assert calls(falling(0.8, 9))
    assert not calls(falling(0.7, 9))
    assert not calls(falling(0.8, 9), transmission=CLASSICAL), "slow by nature"
    assert calls(falling(1.0, 9), transmission=CLASSICAL)
    assert not calls([1e-15] * 20), "rounding is no stall"


def test_subdomains_that_do_not_agree_where_the_mesh_rests() -> None:
    assert calls([0.1, 1e-5], mismatch=0.1)
    assert not calls([0.1, 1e-3], mismatch=0.1)
    assert not calls([0.1, 1e-17], mismatch=1e-13), "a mismatch of rounding"


@pytest.mark.parametrize(("rescued", "expected"), [(2, False), (3, True)])
def test_classical_data_in_three_iterations(rescued: int, expected: bool) -> None:
    assert calls(falling(0.3, 5), rescued=rescued) is expected


def test_steps_on_the_whole_grid_in_a_row() -> None:
    rescue = Rescue(PAPER, WHOLE)
    rescue.residuals = [1.0, 0.5, 0.1]
    assert calls(falling(0.3, 3), rescue=rescue)
    assert not calls(falling(0.3, 3), rescue=rescue, fallback=False)
    assert not calls(falling(1.0, 30), transmission=em.Optimized()), "nothing is left to take over"


def test_the_estimate_is_that_of_the_records() -> None:
    stalls = Stalls(em.Schwarz(transmission=ROBIN), 1e-14)
    assert math.isnan(stalls.estimate(0.1))
    stalls.note(solved(MESH), 0.1, 0.0)
    assert stalls.estimate(0.05) == pytest.approx(0.05)
    assert stalls.estimate(0.09) == pytest.approx(0.09 * 9)


def test_eight_iterations_are_not_slow() -> None:
    stalls = Stalls(em.Schwarz(transmission=ROBIN), 1e-14)
    found = []
    for change in falling(0.5, 10):
        found.append(stalls.was_slow)
        stalls.note(solved(MESH), change, 0.0)
    assert found == [False] * 8 + [True] * 2


@pytest.mark.parametrize(
    ("settings", "deviations", "expected"),
    [
        (em.Schwarz(), [0.3, 0.05], True),
        (em.Schwarz(), [0.3, math.nan], True),
        (em.Schwarz(), [0.05, 1e-3], False),
        (em.Schwarz(), [0.3], False),
        (em.Schwarz(), [0.3, 0.05, 0.05], False),
        (em.Schwarz(acceleration=em.Acceleration.ANDERSON), [0.3, 0.05], False),
        (em.Schwarz(line_correction=2), [0.3, 0.05], False),
        (em.Schwarz(ordering=em.Ordering.SYMMETRIC), [0.3, 0.05], False),
        (em.Schwarz(transmission=ROBIN), [0.3, 0.05], False),
    ],
)
def test_newton_takes_over_after_two_iterations_that_came_no_nearer(
    settings: em.Schwarz, deviations: list[float], expected: bool
) -> None:
    stalls = Stalls(settings, 1e-14)
    for deviation in deviations:
        stalls.note(solved(MESH), 0.1, deviation)
    assert stalls.call_for_newton is expected
