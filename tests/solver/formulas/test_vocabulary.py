"""The vocabulary of formulas and the operations that are known: the same."""

from __future__ import annotations

import math

import numpy as np
import pytest

from equimesh.errors import ExpressionError
from equimesh.fields.expression import FUNCTIONS, Expression
from equimesh.formulas.jet import OPERATIONS
from equimesh.formulas.vocabulary import ARGUMENTS, RESERVED
from solver.formulas.texts import values


def test_functions_and_operations_agree() -> None:
    signs = {"+", "-", "*", "/", "**", "negative", "<", "<=", ">", ">=", "==", "!=", "and", "or", "not"}
    assert set(FUNCTIONS) == set(OPERATIONS) - signs
    assert all(description and "\n" not in description for description in FUNCTIONS.values())


# Formulas made into programs: parameters, and the part that is to blame where a value is not finite.


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


def test_text_must_be_text() -> None:
    with pytest.raises(ExpressionError, match="is text"):
        Expression(3)  # type: ignore[arg-type]


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
    assert error.position.offset == offset
    assert f"the {what} of u is not finite at (x, y) = ({point[0]:g}, {point[1]:g})" in error.message
    assert f"because of {part}:" in error.message
    assert remedy in error.message


# Operations and functions: their values, their derivatives, kinks, and the ends of their domains.


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
    "text", ["log(x - 2)", "1/x", "sqrt(-1 - x)", "x**-1", "(x - 1)**0.5", "log(-1)", "1/0", "asin(2 + x)", "x**y"]
)
def test_outside_its_domain_a_function_is_silently_not_finite(text: str) -> None:
    u = Expression(text).evaluate(np.array([0.0]), np.array([-0.5]), 2)  # warnings are errors here
    assert not np.isfinite(u[0]).any()


def test_a_steep_front_keeps_its_derivatives() -> None:
    u, u_x, _, u_xx, _, _ = values("1/(1 + exp(1200*(1/2 - x)))", 0.0, 0.0)  # the square of exp(600) overflows
    assert u == pytest.approx(math.exp(-600))
    assert u_x == pytest.approx(1200 * u)
    assert u_xx == pytest.approx(1200**2 * u)
