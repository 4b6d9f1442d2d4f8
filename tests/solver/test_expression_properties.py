"""Expressions against an independent evaluator: random formulas, formulas broken at random, random text.

A random formula is a tree. It is written out as text for :class:`Expression`, and evaluated directly with ``cmath``
at a point moved by a tiny imaginary step, which gives the value and one partial derivative to full accuracy.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from equimesh.errors import ExpressionError
from equimesh.expression import FUNCTIONS, Expression

STEP = 1e-40
LARGE = 1e5  # beyond, rounding may differ between any two evaluators
NEAR = 1e-3  # kinks and ends of domains this close are left to the examples of test_expression.py
seeded = settings(derandomize=True, deadline=None, max_examples=250, database=None)


@dataclass(frozen=True)
class Tree:
    """One operation and its operands; a leaf has its text as ``name``."""

    name: str
    parts: tuple[Tree, ...] = ()


class TooClose(Exception):
    """At this point the formula is too close to a kink, the end of a domain, or overflow to be compared."""


def away_from_zero(z: complex) -> complex:
    if abs(z.real) < NEAR:
        raise TooClose
    return z


def positive(z: complex) -> complex:
    if z.real < NEAR:
        raise TooClose
    return z


def inside(z: complex) -> complex:
    if abs(z.real) > 1 - NEAR:
        raise TooClose
    return z


def first_is(sign: int, a: complex, b: complex) -> complex:
    return a if sign * away_from_zero(a - b).real > 0 else b


SMOOTH: dict[str, Callable[..., complex]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / away_from_zero(b),
    "negative": lambda a: -a,
    "sin": cmath.sin,
    "cos": cmath.cos,
    "tan": lambda a: cmath.sin(a) / away_from_zero(cmath.cos(a)),
    "asin": lambda a: complex(math.asin(inside(a).real), a.imag / math.sqrt(1 - a.real**2)),
    "acos": lambda a: complex(math.acos(inside(a).real), -a.imag / math.sqrt(1 - a.real**2)),
    "atan": lambda a: complex(math.atan(a.real), a.imag / (1 + a.real**2)),
    "sinh": cmath.sinh,
    "cosh": cmath.cosh,
    "tanh": lambda a: complex(math.tanh(a.real), a.imag * (1 - math.tanh(a.real) ** 2)),
    "asinh": lambda a: complex(math.asinh(a.real), a.imag / math.sqrt(1 + a.real**2)),
    "acosh": lambda a: complex(math.acosh(1 + positive(a - 1).real), a.imag / math.sqrt(a.real**2 - 1)),
    "atanh": lambda a: complex(math.atanh(inside(a).real), a.imag / (1 - a.real**2)),
    "exp": cmath.exp,
    "log": lambda a: cmath.log(positive(a)),
    "log2": lambda a: cmath.log(positive(a)) / math.log(2),
    "log10": lambda a: cmath.log10(positive(a)),
    "sqrt": lambda a: cmath.sqrt(positive(a)),
    "abs": lambda a: a if away_from_zero(a).real > 0 else -a,
    "sign": lambda a: complex(math.copysign(1, away_from_zero(a).real)),
    "min": lambda a, b: first_is(-1, a, b),
    "max": lambda a, b: first_is(1, a, b),
    "hypot": lambda a, b: cmath.sqrt(positive(a * a + b * b)),
    "atan2": lambda a, b: (
        cmath.phase(complex(b.real, a.real)) + 1j * (a.imag * b.real - a.real * b.imag) / positive(a * a + b * b).real
    ),
    "erf": lambda a: complex(math.erf(a.real), a.imag * 2 / math.sqrt(math.pi) * math.exp(-(a.real**2))),
    "**2": lambda a: a * a,
    "**3": lambda a: a * a * a,
    "**-2": lambda a: 1 / away_from_zero(a) ** 2,
    "**1.5": lambda a: cmath.exp(1.5 * cmath.log(positive(a))),
    "**": lambda a, b: cmath.exp(b * cmath.log(positive(a))),
}
CONDITIONS: dict[str, Callable[..., bool]] = {
    "<": lambda a, b: away_from_zero(a - b).real < 0,
    ">=": lambda a, b: away_from_zero(a - b).real > 0,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
}
INFIX = ("+", "-", "*", "/", "**", "<", ">=", "and", "or")


def write(tree: Tree) -> list[str]:
    """The tokens of a tree, with every bracket that could matter."""
    parts = [write(part) for part in tree.parts]
    if not parts:
        return [tree.name]
    if tree.name in INFIX:
        return ["(", *parts[0], tree.name, *parts[1], ")"]
    if tree.name in ("negative", "not"):
        return ["(", "-" if tree.name == "negative" else "not", *parts[0], ")"]
    if tree.name.startswith("**"):
        return ["(", "(", *parts[0], ")", "**", *tree.name[2:].partition("-")[1:2], tree.name.lstrip("*-"), ")"]
    inside_brackets = parts[0]
    for part in parts[1:]:
        inside_brackets = [*inside_brackets, ",", *part]
    return [tree.name, "(", *inside_brackets, ")"]


def text_of(tree: Tree) -> str:
    return " ".join(token for token in write(tree) if token)


def value_of(tree: Tree, x: complex, y: complex) -> complex:
    """Value, and derivative as the imaginary part in units of ``STEP``."""
    leaves = {"x": x, "y": y, "k": 0.75, "pi": math.pi, "e": math.e}
    if not tree.parts:
        return complex(leaves[tree.name] if tree.name in leaves else float(tree.name))
    if tree.name == "where":
        return value_of(tree.parts[1 if truth_of(tree.parts[0], x, y) else 2], x, y)
    try:
        result = complex(SMOOTH[tree.name](*(value_of(part, x, y) for part in tree.parts)))
    except OverflowError:
        raise TooClose from None
    if not (abs(result.real) < LARGE and abs(result.imag) < LARGE * STEP):
        raise TooClose
    return result


def truth_of(tree: Tree, x: complex, y: complex) -> bool:
    inner = truth_of if tree.name in ("and", "or", "not") else value_of
    return CONDITIONS[tree.name](*[inner(part, x, y) for part in tree.parts])


def operation(names: list[str], *parts: st.SearchStrategy[Tree]) -> st.SearchStrategy[Tree]:
    return st.builds(lambda name, *inner: Tree(name, inner), st.sampled_from(names), *parts)


leaf = st.builds(
    Tree,
    st.sampled_from(["x", "y", "x", "y", "k", "pi", "e"])
    | st.floats(0, 4, allow_subnormal=False).map(lambda value: repr(round(value, 3))),
)
condition = st.recursive(
    operation(["<", ">="], leaf, leaf),
    lambda inner: operation(["and", "or"], inner, inner) | operation(["not"], inner),
    max_leaves=3,
)
BINARY = ["+", "-", "*", "/", "**", "min", "max", "hypot", "atan2"]
UNARY = [name for name in SMOOTH if name not in BINARY]
trees = st.recursive(
    leaf,
    lambda inner: (
        operation(UNARY, inner)
        | operation(BINARY, inner, inner)
        | operation(["+", "-", "*"], inner, inner)
        | operation(["where"], condition, inner, inner)
    ),
    max_leaves=10,
)
coordinate = st.floats(0.0, 1.0, allow_subnormal=False).map(lambda value: round(value, 6))


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
    u = Expression(text_of(tree), parameters={"k": 0.75})
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
    u, h = Expression(text_of(tree), parameters={"k": 0.75}), 1e-4
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
    u = Expression(text_of(tree), parameters={"k": 0.75})
    x, y = np.linspace(0, 1, 5), np.linspace(1, 0, 5)
    together = u.evaluate(x, y, order=2)
    alone = np.transpose([u.evaluate(x[i], y[i], order=2) for i in range(5)])
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9)
    for order in (0, 1):
        for few, many in zip(u.evaluate(x, y, order), together, strict=False):
            np.testing.assert_array_equal(few, many)


@seeded
@given(
    tree=trees, where=st.integers(0, 10**6), bad=st.sampled_from(["$", "^", "[", "'x'", "é", "]", ";", "=", "?", "π"])
)
def test_a_formula_with_a_foreign_sign_is_refused_there(tree: Tree, where: int, bad: str) -> None:
    tokens = [token for token in write(tree) if token]
    where %= len(tokens) + 1
    before = "".join(f"{token}\n " for token in tokens[:where])
    error = refusal(before + bad + " " + " ".join(tokens[where:]))
    assert error is not None
    assert error.position is not None
    if not (where and tokens[where - 1] in FUNCTIONS):
        assert error.position.offset == len(before)
        assert (error.position.line, error.position.column) == (where + 1, 2 if where else 1)


@seeded
@given(tree=trees, where=st.integers(0, 10**6))
def test_a_formula_without_one_of_its_brackets_is_refused(tree: Tree, where: int) -> None:
    tokens = [token for token in write(tree) if token]
    brackets = [index for index, token in enumerate(tokens) if token in "()"]
    assume(brackets)
    del tokens[brackets[where % len(brackets)]]
    assert refusal(" ".join(tokens)) is not None


@seeded
@given(text=st.text(max_size=60))
@example(text="\x00")
@example(text="\ud800")
@example(text="ﬁ(x)")
@example(text="x\u2028+y")
def test_random_text_is_read_or_refused(text: str) -> None:
    refusal(text)


WORDS = [
    *"xyte()+-*/<>,.=!^%_#'\"[]{}:;@&|~$?\\ \n\t0123456789²πｘ\u200b",
    *("**", "//", "==", "!=", "<=", "1e5", "0.5", "where(", "and", "or", "not", "sin(", "max(", "lambda", "if"),
    *("else", "for", "in", "is", "None", "True", "await", "yield", "__import__", ":=", "0x1f", "1j", "k", "min"),
]


@settings(seeded, max_examples=1000)
@given(words=st.lists(st.sampled_from(WORDS), max_size=12), space=st.sampled_from(["", " "]))
def test_random_words_are_read_or_refused(words: list[str], space: str) -> None:
    refusal(space.join(words))


def refusal(text: str) -> ExpressionError | None:
    """The error that refuses the text, if any: it has a place in the text, and can be sent."""
    try:
        u = Expression(text, parameters={"k": 0.75})
    except ExpressionError as refused:
        error = refused
    else:
        u.evaluate(0.5, 0.5, order=2)
        return None
    assert error.position is not None
    offset, lines = error.position.offset, text[: error.position.offset].split("\n")
    assert 0 <= offset <= len(text)
    assert (error.position.line, error.position.column) == (len(lines), len(lines[-1]) + 1)
    assert error.message
    error.message.encode()
    return error
