"""Arithmetic that is written down: the lines, those that are needed, and the rows that they share."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.formulas import routine
from equimesh.formulas.routine import CODES, Line, Trace, Traced, compact


def coordinates() -> tuple[Trace, Traced, Traced]:
    trace = Trace()
    return trace, Traced(trace, routine.X), Traced(trace, routine.Y)


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
