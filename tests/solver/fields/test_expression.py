"""Expressions: what they compute, what they refuse and where, and how they behave at kinks."""

from __future__ import annotations

import ast
import copy
import math
import pickle
import re
import time
from pathlib import Path

import numpy as np
import pytest

import equimesh.fields.expression as module
from equimesh.errors import ExpressionError, InputError
from equimesh.fields.expression import FUNCTIONS, LIMITS, Expression
from equimesh.formulas import vocabulary
from equimesh.formulas.functions import OPERATIONS
from equimesh.formulas.jet import constant, coordinates
from equimesh.formulas.vocabulary import ARGUMENTS, RESERVED


def values(text: str, x: float, y: float, order: int = 2, **parameters: float) -> list[float]:
    return [float(part) for part in Expression(text, parameters=parameters).evaluate(x, y, order)]


def refused(text: str, **parameters: float) -> ExpressionError:
    with pytest.raises(ExpressionError) as caught:
        Expression(text, parameters=parameters)
    return caught.value


def test_the_paper_function_and_its_derivatives() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 5), indexing="ij")
    results = Expression("(1-exp(15*(x-1)))*sin(pi*y)").evaluate(x, y, order=2)
    g, s, c = np.exp(15 * (x - 1)), np.sin(np.pi * y), np.cos(np.pi * y)
    expected = (
        (1 - g) * s,
        -15 * g * s,
        (1 - g) * np.pi * c,
        -225 * g * s,
        -15 * g * np.pi * c,
        -(1 - g) * np.pi**2 * s,
    )
    for result, wanted in zip(results, expected, strict=True):
        assert result.shape == x.shape
        np.testing.assert_allclose(result, wanted, rtol=1e-13, atol=1e-13)


SAFE = {"acosh": "1.5 + x", "where": "x < y, x*y, x**2*y"}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_the_derivatives_of_its_own_differences(name: str) -> None:
    arguments = SAFE.get(name, "0.3*x + 0.2*x*y" if name not in ARGUMENTS else "x*y + 0.1, x - 0.4*y**2")
    u = Expression(f"{name}({arguments})")
    x, y, h = np.array([0.3, 0.45, 0.8]), np.array([0.7, 0.6, 0.25]), 1e-6
    _, u_x, u_y, u_xx, u_xy, u_yy = u.evaluate(x, y, order=2)
    east, west = u.evaluate(x + h, y, 1), u.evaluate(x - h, y, 1)
    north, south = u.evaluate(x, y + h, 1), u.evaluate(x, y - h, 1)
    for derivative, plus, minus in [
        (u_x, east[0], west[0]),
        (u_y, north[0], south[0]),
        (u_xx, east[1], west[1]),
        (u_xy, north[1], south[1]),
        (u_xy, east[2], west[2]),
        (u_yy, north[2], south[2]),
    ]:
        np.testing.assert_allclose(derivative, (plus - minus) / (2 * h), rtol=1e-7, atol=1e-7)


SPOT = [
    ("atan2(y, x)", math.atan2(0.7, 0.4)),
    ("hypot(x, y)", math.hypot(0.4, 0.7)),
    ("erf(x)", math.erf(0.4)),
    ("log2(x)", math.log2(0.4)),
    ("log10(x)", math.log10(0.4)),
    ("acosh(1+x)", math.acosh(1.4)),
    ("min(x, y, 0.1)", 0.1),
    ("max(x, y, 0.1)", 0.7),
    ("sign(x-y)", -1.0),
    ("-x**2", -0.16),
    ("2**-1", 0.5),
    ("2**3**2", 512.0),
    ("x-y-1", -1.3),
    ("x/y/2", 0.4 / 0.7 / 2),
    ("+x", 0.4),
    ("x**0", 1.0),
    ("x**1", 0.4),
    ("x**20", 0.4**20),
    ("x**-3", 0.4**-3),
    ("(-x)**3", -(0.4**3)),
    ("2**x", 2**0.4),
    ("x**y", 0.4**0.7),
    ("e**x", math.exp(0.4)),
    ("where(0.1 < x < 0.5, 1, 2)", 1.0),
    ("where(0.1 < x < 0.2, 1, 2)", 2.0),
    ("where(not x < y, 1, 2)", 2.0),
    ("where(x < 0 or y > 0 and x > 0, 1, 2)", 1.0),
    ("where(x == x, 1, 2)", 1.0),
    ("where(x != x, 1, 2)", 2.0),
    (".5 + 5. + 1e-1 + 1.5E+1", 20.6),
    ("  x\n\t+\r\n y ", 1.1),
]


@pytest.mark.parametrize(("text", "wanted"), SPOT)
def test_values(text: str, wanted: float) -> None:
    assert values(text, 0.4, 0.7, 0)[0] == pytest.approx(wanted, rel=1e-14)


POSITIONS = [
    ("", 0, "empty"),
    (" \n ", 0, "empty"),
    ("x +", 3, "missing after '+'"),
    ("* x", 0, "missing before '*'"),
    ("x * / y", 4, "missing between '*' and '/'"),
    ("max(x,)", 6, "missing between"),
    ("()", 1, "missing between"),
    ("x)", 1, "closes nothing"),
    ("2*(x + (y)", 2, "never closed"),
    ("x^2", 1, "use ** for powers"),
    ("2x", 1, "write 2*x"),
    ("2 x", 2, "write 2*x"),
    ("(x)(y)", 3, "write )*("),
    ("x(y)", 1, "write x*("),
    ("2(x)", 1, "write 2*("),
    ("pi y", 3, "write pi*y"),
    ("(sin)(x)", 1, "write sin(...)"),
    ("sin x", 4, "write sin(...)"),
    ("1 + sin", 4, "write sin(...)"),
    ("xy", 0, "write x*y"),
    ("0,5*x", 1, "point"),
    ("snh(x)", 0, "did you mean sinh?"),
    ("X", 0, "did you mean x?"),
    ("x + alpa", 4, "did you mean alpha?"),
    ("ln(x)", 0, "write log"),
    ("1 + π*x", 4, "write pi"),
    ("foo(x)", 0, "not a known function"),
    ("z", 0, "not a known name"),
    ("__import__('os')", 0, "not a known function"),
    ("x.real", 1, "point"),
    ("np.sin(x)", 0, "write sin(x)"),
    ("x[0]", 1, "group with ( and )"),
    ("'x'", 0, "text"),
    ("f'{x}'", 0, "not a known name"),
    ("lambda: x", 0, "Python"),
    ("x if y else 1", 2, "where(condition, a, b)"),
    ("(x for x in y)", 3, "Python"),
    ("(x := 1)", 3, "assigned"),
    ("max(x, key = 1)", 7, "not a known name"),
    ("max(x, y = 1)", 9, "write =="),
    ("max(*x)", 4, "missing"),
    ("True", 0, "Python"),
    ("None", 0, "Python"),
    ("2j", 0, "complex"),
    ("x # y", 2, "comments"),
    ("x // y", 2, "use /"),
    ("x % y", 2, "remainder"),
    ("x @ y", 2, "use *"),
    ("x & y", 2, "write and"),
    ("1_000", 1, "without _"),
    ("007", 0, "write 7"),
    ("1e400", 0, "too large"),
    ("1" * 41, 0, "40 characters"),
    ("1" * 4000, 0, "40 characters"),
    ("9**9**9**9", 6, "exponent"),
    ("x**1001", 3, "exponent"),
    ("x" + " " * 4096, 4096, "longer than 4096"),
    ("x**" * 150 + "x", 300, "nested more than 100"),
    ("-" * 101 + "x", 100, "nested more than 100"),
    ("x+" * 1000 + "x", 0, "more than 1000 operations"),
    ("x**-1001", 3, "exponent"),
    ("x**(500 + 501)", 4, "exponent"),
    ("x < 1", 0, "where(condition, a, b)"),
    ("1 + (x and y)", 5, "where(condition, a, b)"),
    ("where(x, 1, 2)", 6, "a comparison such as x < 0.5"),
    ("where(x < 1, y < 1, 2)", 13, "where(condition, a, b)"),
    ("where(x < 1, 2)", 0, "3 arguments, not 2"),
    ("where(x is y, 1, 2)", 8, "Python"),
    ("where(x < not y, 1, 2)", 10, "'not'"),
    ("where(x not y, 1, 2)", 8, "'not'"),
    ("sin()", 0, "1 argument, not 0"),
    ("sin(x, y)", 0, "1 argument, not 2"),
    ("1 + min(x)", 4, "2 or more arguments"),
    ("x\x00", 1, "U+0000"),
    ("x\ud800", 1, "U+D800"),
    ("x + ｙ", 4, "write y"),
    ("х", 0, "CYRILLIC"),
    ("x²", 1, "write **2"),
    ("x − y", 2, "minus sign"),
    ("２*x", 0, "write 2"),
    ("x\u00a0+ y", 1, "ordinary space"),
    ("x\u200b", 1, "ZERO WIDTH SPACE"),
]


@pytest.mark.parametrize(("text", "offset", "words"), POSITIONS)
def test_refused_at_its_position(text: str, offset: int, words: str) -> None:
    error = refused(text, alpha=1.0)
    assert words in error.message
    assert error.position is not None
    assert error.position.offset == offset
    assert error.field == "expression"
    error.message.encode()  # so that it can be sent


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [("σ*(\n  σ + é)", 2, 7), ("𝛼", 1, 1), ("σσσ + é", 1, 7), ("x +\r\n\r\n z", 3, 2), ("x\n\n+", 3, 2)],
)
def test_positions_count_characters_and_lines(text: str, line: int, column: int) -> None:
    position = refused(text, σ=1.0, σσσ=2.0).position
    assert position is not None
    assert (position.line, position.column) == (line, column)


def test_positions_of_parsed_parts_count_characters() -> None:
    error = refused("σ +\n σσσ*min(σ)", σ=1.0, σσσ=2.0)  # found by the walk over the tree, not by the tokens
    assert error.position is not None
    assert (error.position.offset, error.position.line, error.position.column) == (9, 2, 6)


@pytest.mark.parametrize(
    "text",
    [
        "(" * 5000,
        "-" * 5000,
        "(" * 4000,
        "-" * 4000 + "x",
        "(" * 101 + "x" + ")" * 101,
        "sin(" * 101 + "x" + ")" * 101,
        "-(" * 101 + "x" + ")" * 101,
        "x**" * 1000 + "x",
        "2**-" * 900 + "x",
        "x+" * 2000 + "x",
        "x" * 4097,
        "where(" * 600,
        "where(x<1," * 150 + "x" + ",y)" * 150,
        "where(" + "not " * 150 + "x<1,1,2)",
        "x<" * 1500 + "x",
        "where(" + "x<" * 1500 + "x,1,2)",
        "max(" + "x," * 1500 + "x)",
    ],
)
def test_monsters_are_refused_quickly(text: str) -> None:
    start = time.process_time()
    assert refused(text).position is not None
    assert time.process_time() - start < 1.0


def test_what_is_long_but_harmless_is_accepted() -> None:
    assert values("+".join(["x*y"] * 200), 0.5, 0.5, 0) == [50.0]
    assert values("(" * 99 + "x" + ")" * 99, 0.5, 0.5, 0) == [0.5]
    assert values("-" * 98 + "x", 0.5, 0.5, 0) == [0.5]
    assert len("1" * LIMITS.digits) == 40
    assert values("1" * 40, 0.5, 0.5, 0) == [float("1" * 40)]


def test_nothing_is_ever_run() -> None:
    sources = [Path(module.__file__), *Path(vocabulary.__file__).parent.glob("*.py")]
    assert {"syntax", "program", "expression"} < {source.stem for source in sources}
    for source in sources:
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "compile", "__import__", "getattr") or (
                    source.stem == "syntax" and node.func.id == "getattr"  # the offset of a SyntaxError
                )


def test_functions_and_operations_agree() -> None:
    signs = {"+", "-", "*", "/", "**", "negative", "<", "<=", ">", ">=", "==", "!=", "and", "or", "not"}
    assert set(FUNCTIONS) == set(OPERATIONS) - signs
    assert all(description and "\n" not in description for description in FUNCTIONS.values())


@pytest.mark.parametrize(
    ("parameters", "where"),
    [
        *(
            ({name: 1.0}, f"parameters.{name}")
            for name in (*RESERVED, "sin", "where", "lambda", "and", "2k", "a b", "")
        ),
        ({"a.b": 1.0}, "parameters.a.b"),
        ({"µ": 1.0}, "parameters.µ"),  # the micro sign, which Python reads as the Greek letter
        ({"a\ud800": 1.0}, "parameters"),
        ({"k" * 41: 1.0}, "parameters." + "k" * 41),
        ({1: 1.0}, "parameters"),
        ({"k": math.nan}, "parameters.k"),
        ({"k": math.inf}, "parameters.k"),
        ({"k": True}, "parameters.k"),
        ({"k": "1"}, "parameters.k"),
        ({"k": None}, "parameters.k"),
        ({"k": 10**5000}, "parameters.k"),
        ({f"k{i}": 1.0 for i in range(101)}, "parameters"),
    ],
)
def test_parameters_that_cannot_be(parameters: dict[str, float], where: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        Expression("x", parameters=parameters)
    assert caught.value.field == where
    assert caught.value.position is None
    caught.value.message.encode()


def test_parameters_and_time_enter_as_numbers() -> None:
    u = Expression("k*x + t*ω", parameters={"k": 2, "ω": 3.0}, t=0.5)
    assert [float(part) for part in u.evaluate(0.25, 0.0, 1)] == [2.0, 2.0, 0.0]
    assert u.names == {"k", "x", "t", "ω"}
    with pytest.raises(ExpressionError) as caught:
        Expression("x", t=math.inf)
    assert caught.value.field == "t"


def test_text_must_be_text() -> None:
    with pytest.raises(ExpressionError, match="is text"):
        Expression(3)  # type: ignore[arg-type]


def test_an_expression_is_a_value() -> None:
    given = {"k": 1.0}
    u = Expression("k*x", parameters=given)
    given["k"] = 2.0
    assert values("k*x", 1.0, 0.0, 0, k=1.0) == [float(u.evaluate(1.0, 0.0)[0])]
    for twin in (pickle.loads(pickle.dumps(u)), copy.deepcopy(u)):
        assert twin == u
        assert hash(twin) == hash(u)
        assert float(twin.evaluate(0.5, 0.0)[0]) == 0.5
    assert u != Expression("k*x", parameters={"k": 3.0})
    with pytest.raises(TypeError):
        u.parameters["k"] = 5.0  # type: ignore[index]
    error = pickle.loads(pickle.dumps(refused("x^2")))
    assert error.position.offset == 1


def test_shapes() -> None:
    u = Expression("x + 2*y")
    assert u.evaluate(1.0, 2.0)[0].shape == ()
    assert u.evaluate(np.zeros((3, 1)), np.ones(4), 2)[5].shape == (3, 4)
    assert u.evaluate(np.zeros((0, 2)), np.zeros((0, 2)), 1)[1].shape == (0, 2)
    assert Expression("1").evaluate(np.zeros(3), np.zeros(3), 1)[0].tolist() == [1.0, 1.0, 1.0]
    assert u.evaluate([1, 2], [3, 4])[0].dtype == np.float64
    strided = np.linspace(0, 1, 12).reshape(3, 4).T
    np.testing.assert_array_equal(u.evaluate(strided, strided)[0], 3 * strided)
    with pytest.raises(InputError, match="0, 1 or 2"):
        u.evaluate(0.0, 0.0, order=3)


def test_blocks_join_without_a_seam() -> None:
    x = np.linspace(0, 1, 3 * 16384 + 17)
    for part, wanted in zip(Expression("x**3*y").evaluate(x, 2 * x, 2), (2 * x**4, 6 * x**3, x**3), strict=False):
        np.testing.assert_allclose(part, wanted, rtol=1e-14)


def test_results_do_not_alias_the_input() -> None:
    x = np.linspace(0, 1, 5)
    (u,) = Expression("x").evaluate(x, x)
    u[:] = 7.0
    assert x[0] == 0.0


def test_structural_zeros_cost_nothing() -> None:
    x, y = coordinates(np.array([0.5]), np.array([0.25]))
    u = OPERATIONS["sin"](OPERATIONS["*"](constant(15.0), x, 2), 2)
    assert u.gradient[1] is None
    assert u.hessian[1:] == (None, None)
    assert OPERATIONS["*"](constant(15.0), x, 2).gradient[0] == 15.0
    assert OPERATIONS["*"](x, y, 2).hessian == (None, 1.0, None)


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


KINKS = [
    ("abs(x)", 0.0, 0.5, [0, 0, 0, 0, 0, 0]),
    ("sign(x)", 0.0, 0.5, [0, 0, 0, 0, 0, 0]),
    ("max(x, -x)", 0.0, 0.5, [0, 0, 0, 0, 0, 0]),
    ("min(x, 3*x)", 0.0, 0.5, [0, 2, 0, 0, 0, 0]),
    ("max(0, x)", 0.0, 0.5, [0, 0.5, 0, 0, 0, 0]),
    ("where(x > 0, 2*x, 3*x)", 0.0, 0.5, [0, 3, 0, 0, 0, 0]),
    ("hypot(x, y)", 0.0, 0.0, [0, 0, 0, 0, 0, 0]),
    ("sqrt(x**2 + y**2)", 0.0, 0.0, [0, 0, 0, 0, 0, 0]),
    ("(x**2 + y**2)**0.5", 0.0, 0.0, [0, 0, 0, 0, 0, 0]),
    ("(x**2 + y**2)**1.5", 0.0, 0.0, [0, 0, 0, 0, 0, 0]),
    ("x**2", 0.0, 0.0, [0, 0, 0, 2, 0, 0]),
    ("x**1", 0.0, 0.0, [0, 1, 0, 0, 0, 0]),
    ("x**0", 0.0, 0.0, [1, 0, 0, 0, 0, 0]),
    ("x**2", -3.0, 0.0, [9, -6, 0, 2, 0, 0]),
    ("x**2.0", -3.0, 0.0, [9, -6, 0, 2, 0, 0]),
    ("x**k", -3.0, 0.0, [9, -6, 0, 2, 0, 0]),
    ("x**3", -2.0, 0.0, [-8, 12, 0, -12, 0, 0]),
    ("x**(2+y)", 0.0, 0.5, [0, 0, 0, 0, 0, 0]),
]


@pytest.mark.parametrize(("text", "x", "y", "wanted"), KINKS)
def test_kinks_and_zeros(text: str, x: float, y: float, wanted: list[float]) -> None:
    assert values(text, x, y, 2, k=2.0) == wanted


@pytest.mark.parametrize(
    ("text", "x", "y", "wanted"),
    [
        ("where(x > 0, log(x), 1 + y)", 0.0, 0.5, [1.5, 0, 1, 0, 0, 0]),
        ("where(x > 0, 1/x, y)", 0.0, 0.5, [0.5, 0, 1, 0, 0, 0]),
        ("where(x <= 0, y, sqrt(x))", 0.0, 0.5, [0.5, 0, 1, 0, 0, 0]),
        ("where(k != 1, x/(k - 1), y**2)", 0.0, 0.5, [0.25, 0, 1, 0, 0, 2]),
        ("where(k == 1, y**2, 1/(k - 1))", 0.0, 0.5, [0.25, 0, 1, 0, 0, 2]),
        ("max(x, where(x > 0, log(x), -1))", 0.0, 0.5, [0, 1, 0, 0, 0, 0]),
    ],
)
def test_the_branch_not_taken_does_not_leak(text: str, x: float, y: float, wanted: list[float]) -> None:
    assert values(text, x, y, 2, k=1.0) == wanted


@pytest.mark.parametrize(
    "text",
    ["log(x - 2)", "1/x", "sqrt(-1 - x)", "x**-1", "(x - 1)**0.5", "log(-1)", "1/0", "asin(2 + x)", "x**y"],
)
def test_outside_its_domain_a_function_is_silently_not_finite(text: str) -> None:
    u = Expression(text).evaluate(np.array([0.0]), np.array([-0.5]), 2)  # warnings are errors here
    assert not np.isfinite(u[0]).any()


def test_a_steep_front_keeps_its_derivatives() -> None:
    u, u_x, _, u_xx, _, _ = values("1/(1 + exp(1200*(1/2 - x)))", 0.0, 0.0)  # the square of exp(600) overflows
    assert u == pytest.approx(math.exp(-600))
    assert u_x == pytest.approx(1200 * u)
    assert u_xx == pytest.approx(1200**2 * u)


NOT_FINITE = [
    ("log(x)", 0, "value", (0, 0), "log(x)", "positive"),
    ("1 + 1/(x - 0.5)", 4, "value", (0.5, 0), "1/(x - 0.5)", "denominator"),
    ("y + sqrt(x)", 4, "gradient", (0, 0), "sqrt(x)", "sqrt(... + 1e-6)"),
    ("2*(y - 1)**0.75", 2, "value", (0, 0), "(y - 1)**0.75", "positive"),
    ("y +\n 3*x**0.75", 7, "gradient", (0, 0), "x**0.75", "1e-6"),
    ("exp(30000*x)", 0, "value", (0.03125, 0), "exp(30000*x)", "below 200"),
    ("where(x < 2, 1, log(x - 3)) + 1/(y - 1)", 30, "value", (0, 1), "1/(y - 1)", "denominator"),
    ("where(log(x) > 0, 1, 1/(x - 1))", 21, "value", (1, 0), "1/(x - 1)", "denominator"),
    ("where(x > 2, log(x - 3), 1/x)", 25, "value", (0, 0), "1/x", "denominator"),
    ("x + sqrt(y)", 4, "gradient", (0, 0), "sqrt(y)", "positive"),
    ("σ*log(σ - y)", 2, "value", (0, 0.5), "log(σ - y)", "positive"),
    ("1/0", 0, "value", (0, 0), "1/0", "denominator"),
    ("acos(x)", 0, "gradient", (1, 0), "acos(x)", "between -1 and 1"),
    ("max(2, 1/x)", 7, "value", (0, 0), "1/x", "denominator"),
    ("atan2(y, x)", 0, "gradient", (0, 0), "atan2(y, x)", "out of the unit square"),
]


@pytest.mark.parametrize(("text", "offset", "what", "point", "part", "remedy"), NOT_FINITE)
def test_check_finite_names_point_and_culprit(
    text: str, offset: int, what: str, point: tuple[float, float], part: str, remedy: str
) -> None:
    u = Expression(text, parameters={"σ": 0.5})
    with pytest.raises(ExpressionError) as caught:
        u.check_finite()
    error = caught.value
    assert error.position is not None
    assert error.position.offset == offset
    assert f"the {what} of u is not finite at (x, y) = ({point[0]:g}, {point[1]:g})" in error.message
    assert f"because of {part}:" in error.message
    assert remedy in error.message


def test_check_finite_refuses_what_cannot_be_squared() -> None:
    with pytest.raises(ExpressionError, match=r"the gradient of u is larger than 1e\+100") as caught:
        Expression("y + 1e101*x").check_finite()
    assert caught.value.position is not None
    assert caught.value.position.offset == 4


@pytest.mark.parametrize(
    "text",
    [
        "0",
        "(1-exp(15*(x-1)))*sin(pi*y)",
        "tanh(60*(sqrt((x-0.5)**2 + (y-0.5)**2) - 0.3))",
        "where(x > 0, x*log(x), 0)",
        "abs(x - 0.5) + max(x, y)",
        "hypot(x - 0.5, y - 0.5)",
        "1/(1 + exp(1000*(x - 0.5)))",
        "tanh(1e12*x) + tanh(1e6*(y - 1/3))",
        "1e90*x + y",
        "1/(1e-14 + (x - 0.33)**2)",
        "abs(x - 1/3)**1.5",
        "where(x < 1/3, 1, 1/(x - 0.3))",
        "1/(x - 1.0000001)",
    ],
)
def test_check_finite_accepts(text: str) -> None:
    Expression(text).check_finite()


def test_check_finite_sees_a_single_bad_point_of_its_grid() -> None:
    with pytest.raises(ExpressionError, match=r"not finite at \(x, y\) = \(0\.25, 0\.75\)"):
        Expression("1/((x - 0.25)**2 + (y - 0.75)**2)").check_finite(n=5)


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
    assert found is not None
    for expected, shown in zip(place, found.groups(), strict=True):
        assert expected is None or float(shown) == pytest.approx(expected, abs=1e-5)
    assert error.position is not None
    assert text[error.position.offset :].startswith(part)
    assert remedy in error.message
