"""Expressions against an independent evaluator: random formulas, formulas broken at random, random text.

A random formula is a tree. It is written out as text for :class:`Expression`, and evaluated directly with ``cmath``
at a point moved by a tiny imaginary step, which gives the value and one partial derivative to full accuracy.
"""

from __future__ import annotations

import cmath
import math
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial, reduce

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from equimesh.errors import ExpressionError
from equimesh.fields.expression import FUNCTIONS, Expression

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
    "positive": lambda a: a,
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
    "min": lambda *all_of: reduce(partial(first_is, -1), all_of),
    "max": lambda *all_of: reduce(partial(first_is, 1), all_of),
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
    "<=": lambda a, b: away_from_zero(a - b).real < 0,
    ">": lambda a, b: away_from_zero(a - b).real > 0,
    ">=": lambda a, b: away_from_zero(a - b).real > 0,
    "==": lambda a, b: away_from_zero(a - b) == 0,
    "!=": lambda a, b: away_from_zero(a - b) != 0,
    "between": lambda a, b, c: away_from_zero(b - a).real > 0 and away_from_zero(b - c).real <= 0,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
}
COMPARISONS = ("<", "<=", ">", ">=", "==", "!=")
INFIX = ("+", "-", "*", "/", "**", *COMPARISONS, "and", "or")
PREFIX = {"negative": "-", "positive": "+", "not": "not"}
# How tightly operations bind, and which operand may bind as tightly as the operation itself.
LEVELS = {
    "or": 1, "and": 2, "not": 3, **dict.fromkeys((*COMPARISONS, "between"), 4), "+": 5, "-": 5, "*": 6, "/": 6,
    "negative": 7, "positive": 7, "**": 8,
}  # fmt: skip


def write(tree: Tree) -> list[str]:
    """The tokens of a tree, with every bracket that could matter."""
    parts = [write(part) for part in tree.parts]
    if not parts:
        return [tree.name]
    if tree.name in INFIX:
        return ["(", *parts[0], tree.name, *parts[1], ")"]
    if tree.name in PREFIX:
        return ["(", PREFIX[tree.name], *parts[0], ")"]
    if tree.name == "between":
        return ["(", *parts[0], "<", *parts[1], "<=", *parts[2], ")"]
    if tree.name.startswith("**"):
        return ["(", "(", *parts[0], ")", "**", *tree.name[2:].partition("-")[1:2], tree.name.lstrip("*-"), ")"]
    inside_brackets = parts[0]
    for part in parts[1:]:
        inside_brackets = [*inside_brackets, ",", *part]
    return [tree.name, "(", *inside_brackets, ")"]


def text_of(tree: Tree) -> str:
    return " ".join(token for token in write(tree) if token)


def sparse_text(tree: Tree) -> str:
    """A tree without a bracket that the rules of precedence make superfluous."""
    parts = [sparse_text(part) for part in tree.parts]
    levels = [level_of(part) for part in tree.parts]
    if tree.name in PREFIX:
        return f"{PREFIX[tree.name]} {bracketed(parts[0], levels[0] < LEVELS[tree.name])}"
    if tree.name == "between":
        a, b, c = (bracketed(part, level <= 4) for part, level in zip(parts, levels, strict=True))
        return f"{a}<{b}<={c}"
    if tree.name.startswith("**"):
        base = bracketed(parts[0], levels[0] <= 8)
        return base + (f"**{bracketed(parts[1], levels[1] < 7)}" if len(parts) > 1 else tree.name)
    if tree.name in INFIX:
        level = LEVELS[tree.name]
        right = bracketed(parts[1], levels[1] <= level)
        return f"{bracketed(parts[0], levels[0] < level or level == 4 == levels[0])} {tree.name}\n{right}"
    return f"{tree.name}({','.join(parts)})" if parts else tree.name


def bracketed(text: str, needed: bool) -> str:
    return f"({text})" if needed else text


def level_of(tree: Tree) -> int:
    return 8 if tree.name.startswith("**") else LEVELS.get(tree.name, 9)


def value_of(tree: Tree, x: complex, y: complex) -> complex:
    """Value, and derivative as the imaginary part in units of ``STEP``."""
    leaves = {"x": x, "y": y, "k": 0.75, "t": 0.3, "pi": math.pi, "e": math.e}
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


SPELLINGS = ["2", "3.", ".5", "0.25", "1e0", "25E-1", "1.5e+0", "002.5", "0", "0.0", "1e-3", "12e-1", "0e9"]
leaf = st.builds(
    Tree,
    st.sampled_from(["x", "y", "x", "y", "k", "t", "pi", "e", *SPELLINGS])
    | st.floats(0, 4, allow_subnormal=False).map(lambda value: repr(round(value, 3))),
)
condition = st.recursive(
    operation([*COMPARISONS], leaf, leaf) | operation(["between"], leaf, leaf, leaf),
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
        | operation(["min", "max"], inner, inner, inner)
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
    u = Expression(text_of(tree), parameters={"k": 0.75}, t=0.3)
    value, u_x, u_y = (float(part) for part in u.evaluate(x, y, order=1))
    assert value == pytest.approx(along_x.real, rel=1e-7, abs=1e-7)
    assert u_x == pytest.approx(along_x.imag / STEP, rel=1e-6, abs=1e-6)
    assert u_y == pytest.approx(along_y.imag / STEP, rel=1e-6, abs=1e-6)


@seeded
@given(tree=trees)
def test_precedence_is_that_of_python(tree: Tree) -> None:
    """Without brackets a formula means what it means with all of them."""
    x, y = np.linspace(0, 1, 7), np.linspace(1, 0, 7) ** 2
    sparse, full = (Expression(text, parameters={"k": 0.75}, t=0.3) for text in (sparse_text(tree), text_of(tree)))
    np.testing.assert_array_equal(sparse.evaluate(x, y, order=1), full.evaluate(x, y, order=1))


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


@settings(seeded, max_examples=400)
@given(words=st.lists(st.sampled_from(WORDS), max_size=12), space=st.sampled_from(["", " "]))
def test_random_words_are_read_or_refused(words: list[str], space: str) -> None:
    refusal(space.join(words))


SNIPPETS = [
    *(
        "(",
        ")",
        ",",
        "+",
        "**",
        "<",
        "not",
        "and",
        "z",
        "K",
        "sin",
        "where",
        "lambda",
        "lambda: 0",
        "x.__class__",
        "x[0]",
    ),
    *(
        "[x for x in y]",
        "(x := 1)",
        "'x'",
        '"""',
        "f'{x}'",
        "__import__('os')",
        "eval('x')",
        "1_0",
        "0x1",
        "1j",
        "1e999",
    ),
    *(
        "9" * 50,
        "9**9**9**9",
        "(" * 120,
        "-" * 120,
        "x+" * 3000,
        "ｘ",
        "х",
        "ѕin",
        "\u2212",
        "\u00a0",
        "\u200b",
        "\ufeff",
        "𝐱",
    ),
    *(
        "\x00",
        "#",
        "\\\n",
        ";",
        "x;y",
        "yield",
        "await x",
        "*x",
        "**x",
        "x if x else y",
        "x is y",
        "x in y",
        "...",
        "None",
    ),
]


@settings(seeded, max_examples=400)
@given(
    tree=trees,
    edits=st.lists(
        st.tuples(st.integers(0, 3), st.integers(0, 10**6), st.sampled_from(SNIPPETS)), min_size=1, max_size=3
    ),
)
def test_a_broken_formula_is_refused_and_never_run(tree: Tree, edits: list[tuple[int, int, str]]) -> None:
    tokens = [token for token in write(tree) if token]
    for kind, where, snippet in edits:
        at = where % (len(tokens) + 1)
        if kind == 0:
            tokens.insert(at, snippet)
        elif kind == 1:
            tokens[at : at + 1] = [snippet]
        elif kind == 2:
            del tokens[at : at + 1]
        else:
            tokens[at : at + 2] = reversed(tokens[at : at + 2])
    with watched() as events:
        refusal(" ".join(tokens))
    assert not events


BOMBS = [
    ("9**9**9**9", "at most 1000"),
    ("x**-1e300", "at most 1000"),
    ("x**huge", "at most 1000"),
    ("1" * 41, "40 characters"),
    ("1" * 5000, "4096 characters"),
    ("x+" * 2100 + "x", "4096 characters"),
    ("+".join(["x"] * 2000), "1000 operations"),
    (f"max({','.join(['x'] * 2000)})", "1000 operations"),
    (f"where({'<'.join(['x'] * 1500)}, 1, 2)", "1000 operations"),
    (f"where({' and '.join(['x<y'] * 400)}, 1, 2)", "1000 operations"),
    ("(" * 2000 + "x" + ")" * 2000, "100 levels"),
    ("-" * 4000 + "x", "100 levels"),
    ("**".join(["x"] * 1000), "100 levels"),
    ("sin(" * 800 + "x" + ")" * 800, "100 levels"),
    ("where(x<1," * 150 + "1" + ",2)" * 150, "100 levels"),
    (f"where({'not ' * 900}x<1, 1, 2)", "100 levels"),
]


@pytest.mark.parametrize(("text", "bound"), BOMBS, ids=[text[:12] for text, _ in BOMBS])
def test_a_bomb_is_stopped_by_a_bound(text: str, bound: str) -> None:
    tracemalloc.start()
    started = time.process_time()
    try:
        with pytest.raises(ExpressionError, match=bound) as caught:
            Expression(text, parameters={"huge": 1e308})
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    assert time.process_time() - started < 2
    assert caught.value.position is not None
    assert 0 <= caught.value.position.offset <= len(text)


LARGEST = [
    "+".join(f"x*{k}" for k in range(1, 251)),
    "+".join(f"erf({k}*x+y)" for k in range(1, 143)),
    "where(x<0.5," * 99 + "x" + ",y)" * 99,
    f"max({','.join(f'x*{k}' for k in range(1, 334))})",
    "**".join(["x"] * 100),
]


@pytest.mark.parametrize("text", LARGEST, ids=[text[:8] for text in LARGEST])
def test_the_largest_expressions_are_evaluated_in_seconds(text: str) -> None:
    """At most 1000 operations for each point: 1e4 of them here, with all derivatives."""
    u = Expression(text)
    x, y = np.random.default_rng(1).random((2, 10_000))
    started = time.process_time()
    u.evaluate(x, y, order=2)
    assert time.process_time() - started < 2


HEARD: list[list[str]] = []


def hear(event: str, _: tuple[object, ...]) -> None:
    if HEARD and event in ("exec", "import", "open", "os.system", "subprocess.Popen", "socket.connect"):
        HEARD[-1].append(event)


@cache
def listen() -> None:
    sys.addaudithook(hear)  # there is no way to take one away again


@contextmanager
def watched() -> Iterator[list[str]]:
    """What the interpreter is made to do that no expression may make it do."""
    listen()
    HEARD.append([])
    try:
        yield HEARD[-1]
    finally:
        HEARD.pop()


def refusal(text: str) -> ExpressionError | None:
    """The error that refuses the text, if any: it has a place in the text, and can be sent."""
    try:
        u = Expression(text, parameters={"k": 0.75}, t=0.3)
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
