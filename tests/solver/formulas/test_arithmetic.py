"""Instructions of compiled arithmetic: each gives what numpy gives, to the last bit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from equimesh.formulas import routine
from equimesh.formulas.routine import CODES

SIZES = (1, routine.BLOCK - 1, routine.BLOCK, 3 * routine.BLOCK + 7)
SPECIAL = [0.0, -0.0, 1.0, np.nan, np.inf, -np.inf, 1e308, 5e-324]


def numbers(size: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.where(random.random(size) < 0.3, random.choice(SPECIAL, size), random.standard_normal(size))


def calculated(code: int, x: np.ndarray, y: np.ndarray, *, by_blocks: bool) -> np.ndarray:
    """One instruction on x, y and 0.5."""
    width = routine.BLOCK if by_blocks else max(x.size, routine.BLOCK)
    memory, results = np.full((4, width), 7.0), np.full((int(by_blocks), x.size), 7.0)
    memory[3] = 0.5
    if not by_blocks:
        memory[0, : x.size], memory[1, : x.size] = x, y
    routine.calculate(np.array([[code, 2, 0, 1, 3]]), memory, 3, x, y, results, np.array([2]))
    return results[0] if by_blocks else memory[2, : x.size]


@pytest.mark.parametrize("by_blocks", [True, False])
@pytest.mark.parametrize("function", [f for f in CODES if f is not np.bitwise_and], ids=lambda f: f.__name__)
def test_every_instruction_gives_the_numbers_of_numpy(function: Callable[..., Any], by_blocks: bool) -> None:
    for size in SIZES:
        x, y = numbers(size, 1), numbers(size, 2)
        if CODES[function] in (routine.AND, routine.OR, routine.NOT, routine.WHERE):
            x, y = ((q > 0).astype(float) if function is not np.where else q for q in (x, y))
        with np.errstate(all="ignore"):
            operands = (x, y, 0.5)[: 3 if function is np.where else function.nin]  # type: ignore[attr-defined]
            expected = function(operands[0] != 0.0, *operands[1:]) if function is np.where else function(*operands)
        found = calculated(CODES[function], x, y, by_blocks=by_blocks)
        assert np.array_equal(found, expected.astype(float), equal_nan=True)


def test_a_copy_keeps_the_numbers() -> None:
    x = numbers(1000, 3)
    assert np.array_equal(calculated(routine.COPY, x, x, by_blocks=True), x, equal_nan=True)
