"""Expressions ready for many points: the numbers of the rules on arrays, to the last bit, on any thread."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import equimesh as em
from equimesh.formulas import routine as module

TEXTS = [
    "20*(x + y/2 - 0.75) / sqrt(1 + (20*(x + y/2 - 0.75))**2)",
    "tanh(20*(x - y)) + hypot(x, y)*erf(y)",
    "where(x < y and not (x > 0.7 or x == 0.1), x**3*y, max(x, y, 0.5)**-2) + abs(x - 0.3)**1.5",
    "x**y + 2**x + min(x, y)**20 - sign(x)*atan2(y, x)",
    "x",
    "1/x + 3",
    "7",
]


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("text", TEXTS)
def test_the_numbers_are_those_of_the_rules_on_arrays(text: str, order: int) -> None:
    program = em.Expression(text)._program
    for size in (1, 513, 40_000):
        x, y = np.random.default_rng(size).random((2, size)) - 0.2
        with np.errstate(all="ignore"):
            expected = program._run(x, y, order, keep=False)[program.result].components(order)
        for one, other in zip(program.evaluate(x, y, order), expected, strict=True):
            assert np.array_equal(one, np.broadcast_to(0.0 if other is None else other, x.shape), equal_nan=True)


def test_points_are_taken_as_they_come() -> None:
    """Not contiguous, not writeable, or none at all; they are not written into."""
    x, y = np.random.default_rng(0).random((2, 600, 2))
    u, at = em.Expression("x*y + sin(x)"), (x[:, 0], np.broadcast_to(0.5, 600))
    assert np.array_equal(u.evaluate(*at)[0], at[0] * 0.5 + np.sin(at[0]))
    y.setflags(write=False)
    assert np.array_equal(u.evaluate(x, y)[0], x * y + np.sin(x))
    assert u.evaluate(np.empty(0), np.empty(0), 2)[5].shape == (0,)


def test_the_memory_does_not_grow_with_the_points() -> None:
    """Where functions of numpy are called, as many points are taken at a time as the cache holds."""
    long = em.Expression(" + ".join(f"sin({k}*x)*cos({k}*y)" for k in range(1, 40)))
    long.evaluate(np.zeros(1), np.zeros(1), 2)
    routine = long._program._routines[2]
    assert routine._chunk * routine._rows <= max(module.MEMORY_NUMBERS, 512 * routine._rows)
    assert not routine._by_blocks


def test_threads_share_an_expression() -> None:
    u = em.Expression(TEXTS[2])
    points = np.random.default_rng(1).random((8, 2, 30_000))
    expected = [em.Expression(TEXTS[2]).evaluate(*at, 1) for at in points]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda at: u.evaluate(*at, 1), points))
    assert all(
        np.array_equal(a, b)
        for one, other in zip(found, expected, strict=True)
        for a, b in zip(one, other, strict=True)
    )
