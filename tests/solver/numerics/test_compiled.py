"""Loops as machine code: the same numbers, also where nothing can be kept on disk."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from equimesh.numerics import compiled as module
from equimesh.numerics.compiled import compiled, vectorised


def mean_square(values: np.ndarray) -> float:
    total = 0.0
    for value in values:
        total += value * value
    return total / len(values)


@pytest.mark.parametrize("make", [compiled, vectorised])
def test_compiled_loops_give_the_same_number(make: Callable[..., Any]) -> None:
    values = np.random.default_rng(1).random(1000)
    found = make(mean_square)(values)
    assert found == pytest.approx(mean_square(values), rel=1e-13)
    assert make(mean_square)(values) == found, "and the same one each time"


def test_without_reordering_sums_are_those_of_python() -> None:
    values = np.random.default_rng(2).random(1000) * 10.0 ** np.random.default_rng(3).integers(-8, 8, 1000)
    assert compiled(mean_square)(values) == mean_square(values)
    assert math.isnan(compiled(mean_square)(np.array([1.0, math.nan])))
    assert math.isnan(compiled(mean_square)(np.empty(0))), "0/0, without an exception"


def test_where_nothing_can_be_kept_it_is_compiled_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[dict[str, Any]] = []

    def njit(**options: Any) -> Callable[[Any], Any]:
        seen.append(options)
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(module, "njit", njit)
    assert compiled(mean_square) is mean_square
    assert [options.get("cache", False) for options in seen] == [True, False]
    assert all(options["nogil"] for options in seen)
