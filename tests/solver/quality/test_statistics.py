"""Extremes and means of numbers in blocks are those of all numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from equimesh.quality.survey import Statistics, fill_parts


def of_blocks(values: np.ndarray, size: int) -> Statistics:
    blocks = [values[None, start : start + size] for start in range(0, values.size, size)]
    parts = np.empty((len(blocks), 1, 4))
    for block, part in zip(blocks, parts, strict=True):
        fill_parts(block, part)
    return Statistics.of(parts[:, 0], values.size)


@pytest.mark.parametrize("size", [1, 7, 100, 1000])
def test_blocks_do_not_matter(size: int) -> None:
    values = np.random.default_rng(size).standard_normal(1000)
    found = of_blocks(values, size)
    assert (found.max, found.min) == (values.max(), values.min())
    assert (found.mean, found.rms) == pytest.approx((values.mean(), math.sqrt(np.mean(values**2))), rel=1e-13)
    assert found.times(2.0) == pytest.approx(tuple(2.0 * value for value in found))


def test_numbers_that_are_not_finite_count_as_in_numpy() -> None:
    values = np.arange(1.0, 31.0)
    values[17] = math.inf
    assert of_blocks(values, 5) == Statistics(math.inf, 1.0, math.inf, math.inf)
    values[3] = math.nan
    assert all(math.isnan(value) for value in of_blocks(values, 5))
