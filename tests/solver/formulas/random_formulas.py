"""Random formulas, and an evaluator of them that shares nothing with the solver's.

A random formula is a tree. It is written out as text for :class:`Expression`, and evaluated directly with ``cmath``
at a point moved by a tiny imaginary step, which gives the value and one partial derivative to full accuracy.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce

from hypothesis import settings
from hypothesis import strategies as st

from equimesh.errors import ExpressionError
from equimesh.fields.expression import Expression

STEP = 1e-40


LARGE = 1e5  # beyond, rounding may differ between any two evaluators


NEAR = 1e-3  # kinks and ends of domains this close are left to the examples of test_expression.py


seeded = settings(derandomize=True, deadline=None, max_examples=50, database=None)


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


def refusal(text: str) -> ExpressionError | None:
    """The error that refuses the text, if any: it has a place in the text, and can be sent."""
    try:
        u = Expression(text, parameters={"k": 0.75}, t=0.3)
    except ExpressionError as refused:
        error = refused
    else:
        u.evaluate(0.5, 0.5, order=2)
        return None
    offset, lines = error.position.offset, text[: error.position.offset].split("\n")
    assert 0 <= offset <= len(text)
    assert (error.position.line, error.position.column) == (len(lines), len(lines[-1]) + 1)
    assert error.message
    error.message.encode()
    return error
