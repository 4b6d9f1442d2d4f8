"""Loops that are called from compiled code by address: the same numbers as from Python."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numba import njit

from equimesh.numerics import calls
from equimesh.numerics.calls import address_of, called_at, loop_of, numpy_loop
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


@compiled
def multiplied_by_itself(loop: int, given: int, values: Array, out: Array) -> None:
    places, count, strides = np.empty(3, np.int64), np.empty(1, np.int64), np.empty(3, np.int64)
    places[0], places[1], places[2] = values.ctypes.data, values.ctypes.data, out.ctypes.data
    strides[:], count[0] = 8, out.size
    numpy_loop(loop, places.ctypes.data, count.ctypes.data, strides.ctypes.data, given)


@pytest.mark.parametrize("function", [np.multiply, np.arctan2, np.power])
def test_a_loop_of_numpy_gives_its_numbers(function: np.ufunc) -> None:
    values, out = np.random.default_rng(1).random(1001), np.zeros(1001)
    multiplied_by_itself(*loop_of(function), values, out)
    np.testing.assert_array_equal(out, function(values, values))


def test_a_function_without_a_loop_over_numbers_is_refused() -> None:
    with pytest.raises(ValueError, match=r"dd->d"):
        loop_of(np.bitwise_and)


def test_another_layout_of_functions_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    at = calls._UfuncHead.from_address
    monkeypatch.setattr(calls, "_UfuncHead", SimpleNamespace(from_address=lambda place: at(place + 4)))
    with pytest.raises(RuntimeError, match="keeps the loops of tanh elsewhere"):
        loop_of(np.tanh)
