"""Formulas made into programs: parameters, and the part that is to blame where a value is not finite."""

from __future__ import annotations

import math

import pytest

from equimesh.errors import ExpressionError
from equimesh.fields.expression import Expression
from equimesh.formulas.vocabulary import RESERVED


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
    assert error.position is not None
    assert error.position.offset == offset
    assert f"the {what} of u is not finite at (x, y) = ({point[0]:g}, {point[1]:g})" in error.message
    assert f"because of {part}:" in error.message
    assert remedy in error.message
