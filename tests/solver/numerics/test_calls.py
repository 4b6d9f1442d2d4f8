"""Compiled loops that are called from compiled code: the same numbers as from Python."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from equimesh.numerics.calls import address_of, called_at
from equimesh.numerics.compiled import compiled, vectorised
from equimesh.numerics.types import Array


@vectorised
def added(values: Array, parts: tuple[int, float], sums: Array) -> float:
    """A sum whose terms may be reordered."""
    total = 0.0
    for k in range(parts[0], values.size):
        sums[k] = values[k] * parts[1]
        total += sums[k]
    return total


@compiled
def called(address: int, values: Array, first: int, factor: float, sums: Array) -> float:
    return called_at(address, added, (values, (first, factor), sums))


NONE = np.zeros(1)
ADDRESS = address_of(added, NONE, (0, 1.0), NONE)


@pytest.mark.parametrize("count", [3, 64, 1001])
def test_it_returns_and_writes_what_the_function_does(count: int) -> None:
    values = np.random.default_rng(count).standard_normal(count) * 1e3
    there = np.zeros(count)  # one array for both: where it lies may decide the order of the sum
    total, here = called(ADDRESS, values, 1, 3.0, there), there.copy()
    there[:] = 0.0
    assert total == added(values, (1, 3.0), there)
    np.testing.assert_array_equal(here, there)
    assert there[0] == 0.0
    assert there[1] == 3.0 * values[1]


def test_the_function_keeps_its_own_machine_code() -> None:
    """There is no copy of it in that of the caller."""
    fresh, values = njit(called.py_func), np.ones(3)  # type: ignore[attr-defined]
    assert fresh(ADDRESS, values, 0, 1.0, np.zeros(3)) == 3.0
    (code,) = fresh.inspect_llvm().values()
    assert "added" not in code
