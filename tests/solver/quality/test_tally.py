"""A tally of errors: from nodal values or without them, of all cells or of some."""

from __future__ import annotations

import math

import numpy as np
import pytest

from equimesh.quality.cells import BilinearCells
from equimesh.quality.tally import ErrorRule, ErrorTally
from solver.quality.handmade import TANH20, wavy


def tally(numbers: np.ndarray | None = None, nodal: np.ndarray | None = None) -> ErrorTally:
    found = ErrorTally.of(BilinearCells(wavy()), TANH20, ErrorRule.lean(), numbers, nodal)
    found.add_all()
    found.add_edges()
    return found


def test_some_cells_have_the_errors_that_they_have_among_all() -> None:
    numbers = np.array([3, 90, 17, 42])
    every, some = tally(), tally(numbers)
    assert some.sums == pytest.approx(every.sums[:, numbers], rel=1e-9, abs=1e-15)
    assert some.largest == pytest.approx(every.largest[numbers], rel=1e-9)
    assert every.range[0] < some.range[0] < some.range[1] < every.range[1]


def test_known_nodal_values_change_nothing() -> None:
    nodal = TANH20.evaluate(*BilinearCells(wavy()).nodes)[0]
    for numbers in (None, np.array([3, 90, 17, 42])):
        assert tally(numbers, nodal).sums == pytest.approx(tally(numbers).sums, rel=1e-12)


def test_a_block_with_nan_has_no_part_in_the_range() -> None:
    found = tally()
    before = found.range
    found.ends.append((math.nan, math.nan))
    assert found.range == before
    found.ends.append((-9.0, 0.0))
    assert found.range == (-9.0, before[1])
