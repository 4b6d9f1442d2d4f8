"""The verdicts on sweeps: solved, lost, or one more."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.sweeps.stopping import (
    CONTRACTION,
    DONE,
    GO_ON,
    GRID_ERROR,
    HALVE,
    LEFT,
    LOST,
    MAX_SLOW_SWEEPS,
    RESIDUAL,
    Rules,
    judge,
    nothing_known,
)

RULES = Rules(tight=False, known=True, has_coarse=True, tolerance=1e-10, start_error=1e-3, contraction=0.5, per_gap=3.0)


def test_a_level_is_solved_at_a_fifth_of_the_error_of_its_grid() -> None:
    record, known = np.array([0.1, 0.0, 0.0, 0.0]), nothing_known(1.0)
    assert judge(RULES, known, 0.21, 1.0, 3.0, record) == GO_ON
    assert judge(RULES, nothing_known(1.0), 0.19, 1.0, 3.0, record) == DONE
    assert record[LEFT] == pytest.approx(0.19)
    assert record[CONTRACTION] == 0.5
    assert record[GRID_ERROR] == 1.0
    assert judge(RULES, known, 0.1, 0.5, 3.0, record) == GO_ON, "nothing is known of what a shortened sweep leaves"


def test_without_a_coarser_solution_it_is_the_start_of_a_finer_one() -> None:
    rules, record = RULES._replace(known=False, has_coarse=False), np.array([0.1, 0.0, 0.0, 0.0])
    assert judge(rules, nothing_known(1.0), 2e-3, 1.0, np.nan, record) == GO_ON
    assert judge(rules, nothing_known(1.0), 1e-3, 1.0, np.nan, record) == DONE


def test_a_tight_level_is_solved_at_its_tolerance() -> None:
    record = np.array([2e-10, 0.0, 0.0, 0.0])
    rules = RULES._replace(tight=True)
    assert judge(rules, nothing_known(1.0), 1e-12, 1.0, np.nan, record) == GO_ON
    record[RESIDUAL] = 1e-10
    assert judge(rules, nothing_known(1.0), 1e-2, 1.0, np.nan, record) == DONE


def test_slow_sweeps_are_halved_and_then_given_up() -> None:
    record, known = np.array([0.1, 0.0, 0.0, 0.0]), nothing_known(1.0)
    verdicts = [judge(RULES, known, 1.0, 1.0, 3.0, record) for _ in range(MAX_SLOW_SWEEPS + 1)]
    assert known[HALVE] == 0.0
    verdicts.append(judge(RULES, known, 1.0, 1.0, 3.0, record))
    assert known[HALVE] == 1.0
    assert verdicts == [GO_ON] * (MAX_SLOW_SWEEPS + 2)
    again = [judge(RULES, known, 1.0, 1.0, 3.0, record) for _ in range(MAX_SLOW_SWEEPS + 2)]
    assert again == [GO_ON] * (MAX_SLOW_SWEEPS + 1) + [LOST]
