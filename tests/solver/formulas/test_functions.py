"""Operations and functions: their values, their derivatives, kinks, and the ends of their domains."""

from __future__ import annotations

import math

import numpy as np
import pytest

from equimesh.fields.expression import FUNCTIONS, Expression
from equimesh.formulas.vocabulary import ARGUMENTS
from solver.formulas.texts import values

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
