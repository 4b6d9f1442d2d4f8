"""The formulas of pages mean what the service understands by them, or are refused there, too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.formulas.vocabulary import FUNCTIONS

Run = Callable[..., Any]
PARAMETERS = {"k": 3.0, "eps": 0.25}
X, Y = np.array([0.1, 0.5, 0.8, 0.3]), np.array([0.2, 0.5, 0.35, 0.95])
EVALUATE = """
const u = kernel.compile(given.text, given.constants);
const [x, y] = [Float64Array.from(given.x), Float64Array.from(given.y)];
return [...u.evaluate(x, y).map((part) => part.slice()), u.values(x, y)];
"""
ONE = (
    "acosh(1 + x)",
    "atan2(y - 0.5, x)",
    "hypot(x - 0.5, y - 0.5)",
    "min(x, y, 0.4)",
    "max(x, y)",
    "where(x < y, x*y, 2)",
)
CALLS = [next((call for call in ONE if call.startswith(f"{name}(")), f"{name}(0.9*x*y + 0.05)") for name in FUNCTIONS]
TEXTS = [
    *CALLS,
    *("x^2", "x²y", "x⁻¹", "2x", "x y", "3 sin(x)", "2(x + 1)(y - 1)", "x(1 - x)", "sin x", "2 sin x + 1", "|x - y|"),
    *("−x", "x·y", "x ÷ (1 + y)", "2πx", "np.sin(x) + math.cos(y)", "ln(x) + arctan2(x, y) + sgn(x - y)", "-x^2"),
    *("2^-x", "x^y^2", "x^2y", "e²x", "||x| - 1|", "2e3x", "k x + eps*t", "(x + y)**0.5", "(x - 0.5)**3/(y + 1)**-2"),
    *("where(0.2 < x <= 0.5 and not (y > 0.4 or x == y), exp(-t)*y, 1 - x)", "where((x) < (y), 1, 0)", "-(-x) + +y"),
    "+".join(["where(((((((x)))))) < y, x, 1)"] * 80),  # each bracket may begin a condition
    *("sqrt((x - 0.5)**2 + (y - 0.5)**2)", "abs(x - 0.5)", "x**x", "0*x + 1", "tanh(k*(x + y/2 - 0.75))", "7"),
]
REFUSED = [
    *("", "xy", "e(x)", "e2", "x 2", "1/2x", "e^2x", "sin x y", "sin 2x", "sin x/2", "sin x^2", "sin^2(x)", "|x|y|z|"),
    *("x < y", "sin", "sin()", "atan2(x)", "where(x, 1, 2)", "(x", "x)", "x +", "x, y", "x = y", "x // y", "q", "x.y"),
    *("1e999", "2j", "where(x < 1, 2)", "x²³x³ **2", "__proto__", "constructor(x)", "toString", "x[0]", "not x"),
    "2\n(x)",
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_a_formula_has_the_values_and_the_gradient_of_the_service(kernel: Run, text: str) -> None:
    expected = em.Expression(text, parameters=PARAMETERS, t=0.3).evaluate(X, Y, order=1)
    given = {"text": text, "constants": {**PARAMETERS, "t": 0.3}, "x": X.tolist(), "y": Y.tolist()}
    *found, alone = kernel(EVALUATE, given)
    for mine, its in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, its, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(alone, found[0])


@pytest.mark.parametrize("text", REFUSED)
def test_what_the_service_refuses_is_refused_with_a_sentence(kernel: Run, text: str) -> None:
    with pytest.raises(em.ExpressionError):
        em.Expression(text)
    with pytest.raises(ValueError, match=r"\w+ \w+") as caught:
        kernel("return kernel.compile(given).names", text)
    assert "undefined" not in str(caught.value)
    assert "not a function" not in str(caught.value)
