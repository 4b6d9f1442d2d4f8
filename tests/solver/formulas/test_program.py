"""Programs: blocks of points, equal parts, constants, derivatives, and the same numbers on any thread."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
import scipy
from hypothesis import assume, given

import equimesh as em
from equimesh.errors import ExpressionError
from equimesh.fields.expression import FUNCTIONS, LIMITS, Expression
from equimesh.formulas import routine as module
from equimesh.formulas.routine import CODES, Line, Trace, TracedRow, compact
from equimesh.numerics.calls import loop_of
from solver.formulas.random_formulas import (
    LARGE,
    SMOOTH,
    STEP,
    TooClose,
    Tree,
    coordinate,
    seeded,
    text_of,
    trees,
    value_of,
)


def test_blocks_join_without_a_seam() -> None:
    x = np.linspace(0, 1, 3 * 16384 + 17)
    for part, wanted in zip(Expression("x**3*y").evaluate(x, 2 * x, 2), (2 * x**4, 6 * x**3, x**3), strict=False):
        np.testing.assert_allclose(part, wanted, rtol=1e-14)


def test_results_do_not_alias_the_input() -> None:
    x = np.linspace(0, 1, 5)
    (u,) = Expression("x").evaluate(x, x)
    u[:] = 7.0
    assert x[0] == 0.0


def test_equal_parts_are_evaluated_once_and_constants_never() -> None:
    def steps(text: str) -> list[str]:
        return [step.name for step in Expression(text, parameters={"k": 2.0})._program.steps]

    assert steps("sin(x*y)**2 + cos(x*y) + sin(x*y)").count("*") == 1
    assert steps("sin(x*y) + sin(x*y)").count("sin") == 1
    assert steps("(2*pi/k)*x") == ["x", "*"]
    assert steps("where(k > 1, x, log(x))") == ["x"]
    assert steps("1 + 2*k") == []


def test_what_only_a_condition_needs_has_no_derivatives() -> None:
    steps = Expression("where(sin(x) < 0.5, y**2, sign(cos(y)))")._program.steps
    assert {step.name for step in steps if step.value_only} == {"<", "sin", "x", "cos"}
    shared = Expression("where(sin(x) < 0.5, sin(x), y)")._program.steps
    assert [step.value_only for step in shared if step.name == "sin"] == [False]


def test_equal_numbers_of_different_sign_are_not_merged() -> None:
    u = Expression("atan2(where(x < 0.5, 0.0, -0.0), -1)")
    assert u.evaluate([0.0, 1.0], [0.0, 0.0])[0].tolist() == [math.pi, -math.pi]


def test_the_evaluator_knows_every_function() -> None:
    assert {*FUNCTIONS} <= {*SMOOTH, "where"}


@seeded
@given(tree=trees, x=coordinate, y=coordinate)
def test_value_and_gradient(tree: Tree, x: float, y: float) -> None:
    try:
        along_x = value_of(tree, complex(x, STEP), complex(y))
        along_y = value_of(tree, complex(x), complex(y, STEP))
    except TooClose:
        assume(False)
    u = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3)
    value, u_x, u_y = (float(part) for part in u.evaluate(x, y, order=1))
    assert value == pytest.approx(along_x.real, rel=1e-7, abs=1e-7)
    assert u_x == pytest.approx(along_x.imag / STEP, rel=1e-6, abs=1e-6)
    assert u_y == pytest.approx(along_y.imag / STEP, rel=1e-6, abs=1e-6)


@seeded
@given(tree=trees, x=coordinate, y=coordinate)
def test_hessian(tree: Tree, x: float, y: float) -> None:
    """The Hessian against differences of the gradient, where two step sizes agree on these."""
    try:
        value_of(tree, complex(x), complex(y))
    except TooClose:
        assume(False)
    u, h = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3), 1e-4
    points = np.array([(x + s * h, y) for s in (-2, -1, 1, 2)] + [(x, y + s * h) for s in (-2, -1, 1, 2)]).T
    _, u_x, u_y = u.evaluate(points[0], points[1], order=1)
    *_, u_xx, u_xy, u_yy = u.evaluate(x, y, order=2)
    assume(bool(np.isfinite([*u_x, *u_y]).all()) and max(np.abs([*u_x, *u_y])) < LARGE)
    compared = 0
    for slopes, part in ((u_x[:4], u_xx), (u_x[4:], u_xy), (u_y[:4], u_xy), (u_y[4:], u_yy)):
        near, far = (slopes[2] - slopes[1]) / (2 * h), (slopes[3] - slopes[0]) / (4 * h)
        if abs(near - far) < 1e-4 * (1 + abs(near)):
            compared += 1
            assert float(part) == pytest.approx(near, rel=1e-3, abs=1e-3 * (1 + max(np.abs(slopes)) / 10))
    assume(compared > 0)


@seeded
@given(tree=trees)
def test_arrays_agree_with_single_points(tree: Tree) -> None:
    u = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3)
    x, y = np.linspace(0, 1, 5), np.linspace(1, 0, 5)
    together = u.evaluate(x, y, order=2)
    alone = np.transpose([u.evaluate(x[i], y[i], order=2) for i in range(5)])
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9)
    for order in (0, 1):
        for few, many in zip(u.evaluate(x, y, order), together, strict=False):
            np.testing.assert_array_equal(few, many)


LARGEST = [
    "+".join(f"x*{k}" for k in range(1, 251)),
    "+".join(f"erf({k}*x+y)" for k in range(1, 143)),
    "where(x<0.5," * 99 + "x" + ",y)" * 99,
    f"max({','.join(f'x*{k}' for k in range(1, 334))})",
    "**".join(["x"] * 100),
]


@pytest.mark.parametrize("text", LARGEST, ids=[text[:8] for text in LARGEST])
def test_the_largest_expressions_are_programs_of_few_steps(text: str) -> None:
    """At most 1000 operations for each point, with all derivatives."""
    u = Expression(text)
    assert 100 <= len(u._program.steps) <= LIMITS.nodes == 1000
    x, y = np.random.default_rng(1).random((2, 1000))
    assert all(part.shape == x.shape for part in u.evaluate(x, y, order=2))


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


SIZES = (1, module.BLOCK - 1, module.BLOCK, 3 * module.BLOCK + 7)
SPECIAL = [0.0, -0.0, 1.0, np.nan, np.inf, -np.inf, 1e308, 5e-324]
CALLED = (np.tanh, np.cos, np.sign, np.log, np.hypot, np.arctan2, np.power, np.maximum, scipy.special.erf)


def numbers(size: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.where(random.random(size) < 0.3, random.choice(SPECIAL, size), random.standard_normal(size))


def calculated(function: Callable[..., Any], x: np.ndarray, operands: tuple[int, ...]) -> np.ndarray:
    """One function of these rows: x, x backwards, and the numbers 2, 0.5 and -1 from the row 3 on."""
    memory, rows = np.full((6, module.BLOCK + module.GAP), 7.0), np.full((2, x.size), 7.0)
    memory[3:] = [[2.0], [0.5], [-1.0]]
    one, two, three = (*operands, 0, 0)[:3]
    loops = np.zeros((1, 3), dtype=np.int64)
    if function not in CODES:
        loops[0], three = (*loop_of(function), function.nin), 0  # type: ignore[arg-type, attr-defined]
    line = np.array([[CODES.get(function, module.CALL), 2, one, two, three]])
    module.calculate(module.Table(line, loops, memory, 3, np.array([2])), x, x[::-1].copy(), rows)
    assert (rows[1] == 7.0).all()
    return rows[0]


def test_the_rows_do_not_touch(monkeypatch: pytest.MonkeyPatch) -> None:
    """NumPy 1.26 has other last digits where the end of what a loop reads is the begin of what it writes."""
    widths = list[int]()
    monkeypatch.setattr(module, "calculate", lambda table, *_: widths.append(table.memory.shape[1]))
    for size in SIZES:
        em.Expression("log(x)").evaluate(np.ones(size), np.ones(size))
        assert widths.pop() > min(size, module.BLOCK)


@pytest.mark.parametrize(
    "function", [*[f for f in CODES if f is not np.bitwise_and], *CALLED], ids=lambda f: f.__name__
)
def test_every_instruction_gives_the_numbers_of_numpy(function: Callable[..., Any]) -> None:
    are_conditions = CODES.get(function) in (module.AND, module.OR, module.NOT)
    inputs = 3 if function is np.where else function.nin  # type: ignore[attr-defined]
    for size in SIZES:
        x = numbers(size, 1)
        x = (x > 0).astype(float) if are_conditions else x
        for rows in ((0, 1, 4), (1, 3, 0), (1, 4, 3), (5, 0, 1)):
            if are_conditions and rows != (0, 1, 4):
                continue
            operands = tuple((x, x[::-1].copy(), None, 2.0, 0.5, -1.0)[row] for row in rows[:inputs])
            with np.errstate(all="ignore"):
                condition = np.asarray(operands[0]) != 0.0
                expected = function(condition, *operands[1:]) if function is np.where else function(*operands)
            found = calculated(function, x, rows[:inputs])
            assert np.array_equal(found, np.broadcast_to(expected, x.shape).astype(float), equal_nan=True)


# Arithmetic that is written down: the lines, those that are needed, and the rows that they share.


def coordinates() -> tuple[Trace, TracedRow, TracedRow]:
    trace = Trace()
    return trace, TracedRow(trace, module.X), TracedRow(trace, module.Y)


def test_every_operation_is_a_line() -> None:
    trace, x, y = coordinates()
    np.where(x < 0.5, np.tanh(2.0 * x), -y)
    assert trace.lines == [
        Line(module.LESS, 2, (0, 0.5)),
        Line(module.MULTIPLY, 3, (2.0, 0)),
        Line(np.tanh, 4, (3,)),
        Line(module.NEGATE, 5, (1,)),
        Line(module.WHERE, 6, (2, 4, 5)),
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
    assert trace.needed([module.X]) == []


def test_rows_are_used_again_but_never_while_they_are_read() -> None:
    trace, x, y = coordinates()
    kept = total = x + y
    for _ in range(20):
        half = 0.5 * total
        total = np.sqrt(half * x) + y * half
    lines, results, rows = compact(trace.lines, [kept.row, total.row])
    assert rows <= module.FIRST_FREE + 5
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


@pytest.mark.parametrize("shift", [0.0, 100.0, 1e5])
def test_it_finds_poles_between_its_points_away_from_the_origin(shift: float) -> None:
    domain, parameters = em.Rectangle(x=(shift, shift + 1)), {"m": shift, "d": 1e-17 * max(1.0, shift)}
    poles = ("1/(x - m - 1/3)", "sqrt(abs(x - m - 1/3))", "1/(x - m - 0.25 + d)")  # d: a rounding error
    for pole in poles:
        with pytest.raises(em.ExpressionError, match="grows without bound"):
            em.Expression(pole, parameters=parameters).check_finite(domain=domain)
    em.Expression("tanh(1000*(x - m - 1/3))", parameters=parameters).check_finite(domain=domain)


def test_it_finds_poles_in_a_sector() -> None:
    with pytest.raises(em.ExpressionError, match="grows without bound") as caught:
        em.Expression("1/(hypot(x, y) - 4/3)").check_finite(domain=em.AnnulusSector())
    x, y = (float(part) for part in caught.value.message.split("= (")[1].split(")")[0].split(","))
    assert math.hypot(x, y) == pytest.approx(4 / 3, rel=1e-4)


POLES = [
    ("1/(x - 1/3)", (1 / 3, None), "1/(x - 1/3)", "denominator"),
    ("y + tan(pi*x)", (0.5, None), "tan(pi*x)", "3*pi/2"),
    ("1e-9/((x - 0.3)**2 + (y - 0.7)**2)", (0.3, 0.7), "1e-9/(", "denominator"),
    ("tanh(30*(y - x)) + log(abs(y - 0.41))", (None, 0.41), "log(", "positive"),
    ("sqrt(abs(x - 0.71))", (0.71, None), "sqrt(", "finite slope"),
    ("sqrt((x - 1/3)**2 - 1e-6)", (None, None), "sqrt(", "positive"),  # not defined between two points of the grid
    ("atan2(y - 0.41, x - 0.3)", (0.3, 0.41), "atan2(", "out of the unit square"),
    ("where(x < 0.3, 1, 1/(x - 0.31))", (0.31, None), "1/(x - 0.31)", "denominator"),
]


@pytest.mark.parametrize(("text", "place", "part", "remedy"), POLES, ids=[pole[0] for pole in POLES])
def test_check_finite_finds_poles_between_the_points_of_its_grid(
    text: str, place: tuple[float | None, float | None], part: str, remedy: str
) -> None:
    with pytest.raises(ExpressionError, match="gradient of u grows without bound at") as caught:
        Expression(text).check_finite()
    error = caught.value
    found = re.search(r"\(x, y\) = \(([^,]+), ([^)]+)\)", error.message)
    for expected, shown in zip(place, found.groups(), strict=True):
        assert expected is None or float(shown) == pytest.approx(expected, abs=1e-5)
    assert text[error.position.offset :].startswith(part)
    assert remedy in error.message


def test_a_program_is_kept_for_the_same_numbers() -> None:
    """Numbers that are equal but for their sign are others: 1/t is infinite with another sign."""
    first, again = (em.Expression("k*x + 1/t", parameters={"k": 2.0}, t=0.0) for _ in range(2))
    assert first._program is again._program
    for other in (
        em.Expression("k*x + 1/t", parameters={"k": 2.0}, t=-0.0),
        em.Expression("k*x + 1/t", parameters={"k": 3.0}, t=0.0),
        em.Expression("k*x + 1/t", parameters={"k": 2.0, "c": 1.0}, t=0.0),
    ):
        assert other._program is not first._program
