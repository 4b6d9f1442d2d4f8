"""Expressions ready for many points: the numbers of the rules on arrays, to the last bit, on any thread."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.formulas import routine
from equimesh.formulas import routine as module
from equimesh.formulas.routine import CODES, Line, Trace, TracedRow, compact

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


# Instructions of compiled arithmetic: each gives what numpy gives, to the last bit.


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


# Arithmetic that is written down: the lines, those that are needed, and the rows that they share.


def coordinates() -> tuple[Trace, TracedRow, TracedRow]:
    trace = Trace()
    return trace, TracedRow(trace, routine.X), TracedRow(trace, routine.Y)


def test_every_operation_is_a_line() -> None:
    trace, x, y = coordinates()
    np.where(x < 0.5, np.tanh(2.0 * x), -y)
    assert trace.lines == [
        Line(routine.LESS, 2, (0, 0.5)),
        Line(routine.MULTIPLY, 3, (2.0, 0)),
        Line(np.tanh, 4, (3,)),
        Line(routine.NEGATE, 5, (1,)),
        Line(routine.WHERE, 6, (2, 4, 5)),
    ]


def test_a_row_is_no_number() -> None:
    """The row 0 is that of x; the number 0.0 is a number."""
    trace, x, _ = coordinates()
    assert x + 0.0 is not x
    assert [type(part) for part in trace.lines[0].operands] == [int, float]


def test_a_question_about_numbers_that_are_not_known_is_answered_with_yes() -> None:
    _, x, _ = coordinates()
    assert np.any(x == 0.0) is True


def test_what_is_no_work_number_by_number_is_refused() -> None:
    _, x, y = coordinates()
    with pytest.raises(TypeError):
        np.add.reduce(x)
    with pytest.raises(TypeError):
        np.concatenate([x, y])


def test_lines_without_influence_are_left_out() -> None:
    trace, x, y = coordinates()
    wanted = x * y
    np.exp(wanted)
    assert [line.target for line in trace.needed([wanted.row])] == [wanted.row]
    assert trace.needed([routine.X]) == []


def test_rows_are_used_again_but_never_while_they_are_read() -> None:
    trace, x, y = coordinates()
    kept = total = x + y
    for _ in range(20):
        half = 0.5 * total
        total = np.sqrt(half * x) + y * half
    lines, results, rows = compact(trace.lines, [kept.row, total.row])
    assert rows <= routine.FIRST_FREE + 5
    assert all(line.target not in line.operands for line in lines)
    assert results[0] not in [line.target for line in lines[1:]], "a result stays"
    memory = np.zeros((rows, 3))
    memory[:2] = [[0.1, 0.5, 2.0], [1.0, 0.3, 0.2]]
    functions = {code: function for function, code in CODES.items()}
    for line in lines:
        operands = [memory[part] if isinstance(part, int) else part for part in line.operands]
        memory[line.target] = functions[line.operation](*operands)  # type: ignore[index]
    expected = memory[0] + memory[1]
    assert np.array_equal(memory[results[0]], expected)
    for _ in range(20):
        half = 0.5 * expected
        expected = np.sqrt(half * memory[0]) + memory[1] * half
    assert np.array_equal(memory[results[1]], expected)
