"""Formulas as people write them: what each means, what is refused because it can be read in two ways."""

from __future__ import annotations

import random
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from equimesh.errors import ExpressionError
from equimesh.fields.expression import Expression
from equimesh.formulas.spelling import describe, scan, shorten
from equimesh.formulas.vocabulary import LIMITS
from solver.formulas.random_formulas import Tree, refusal, seeded, sparse_text, trees, write
from solver.formulas.texts import check_refused_at

PARAMETERS = {"k": 0.75, "alpha": 1.0, "π": 3.0, "σ": 0.1}
UNDERSTOOD = [
    ("x^2", "x**2"),
    ("-x^2", "-x**2"),
    ("2^-x", "2**-x"),
    ("x^y^t", "x**y**t"),
    ("x² + y³", "x**2 + y**3"),
    ("x⁻¹", "x**-1"),
    ("2x", "2*x"),
    ("2 x", "2*x"),
    ("x y", "x*y"),
    ("x\u00a0y", "x*y"),
    ("3 sin(x)", "3*sin(x)"),
    ("3sin(x)cos(y)", "3*sin(x)*cos(y)"),
    ("2(x + 1)(y - 1)", "2*(x + 1)*(y - 1)"),
    ("x(1 - x)", "x*(1 - x)"),
    ("k(x - y)", "k*(x - y)"),
    ("2k x", "2*k*x"),
    ("3x^2y", "3*x**2*y"),
    ("x^2(1-x)^2", "x**2*(1-x)**2"),
    ("x²y", "x**2*y"),
    ("e²x", "e**2*x"),
    ("e^(2x) y", "e**(2*x)*y"),
    ("2e^x", "2*e**x"),
    ("2e3", "2e3"),
    ("2e3x", "2e3*x"),
    ("x/(2y)", "x/(2*y)"),
    ("2x/3", "2*x/3"),
    ("x/2*3 y", "x/2*3*y"),
    ("sin x", "sin(x)"),
    ("sin x + cos y", "sin(x) + cos(y)"),
    ("2 sin x - 1", "2*sin(x) - 1"),
    ("max(sin x, cos y)", "max(sin(x), cos(y))"),
    ("|x|", "abs(x)"),
    ("|x - y|^2", "abs(x - y)**2"),
    ("2|x| + 3|y|", "2*abs(x) + 3*abs(y)"),
    ("|x|*y*|t|", "abs(x)*y*abs(t)"),
    ("||x| - 1|", "abs(abs(x) - 1)"),
    ("|x - |y||", "abs(x - abs(y))"),
    ("|sin x|", "abs(sin(x))"),
    ("where(x<1 and not|y|<2, 1, 2)", "where(x<1 and not abs(y)<2, 1, 2)"),
    ("x − y – t", "x - y - t"),
    ("2·x×y÷t", "2*x*y/t"),
    ("where(x ≤ y, 1, 2)", "where(x <= y, 1, 2)"),
    ("np.sin(x) + numpy.tanh(y)*math.pi", "sin(x) + tanh(y)*pi"),
    ("np.arctan2(x, y)", "atan2(x, y)"),
    ("np.where(x < y, 1, np.maximum(x, y))", "where(x < y, 1, max(x, y))"),
    ("ln(x)", "log(x)"),
    ("2 x  +  π", "2*x  +  π"),
]


@pytest.mark.parametrize(("text", "understood"), UNDERSTOOD)
def test_what_is_understood(text: str, understood: str) -> None:
    u, same = Expression(text, parameters=PARAMETERS, t=0.3), Expression(understood, parameters=PARAMETERS, t=0.3)
    assert (u.text, u.understood) == (text, understood)
    assert same.understood == understood
    np.testing.assert_array_equal(u.evaluate(0.3, 0.6, order=2), same.evaluate(0.3, 0.6, order=2))


def test_pi_of_printed_formulas() -> None:
    for text in ("sin(2πx)", "sin(2π x)", "sin(2·π·x)"):
        assert Expression(text).understood == "sin(2*pi*x)"
    assert Expression("xπ²").understood == "x*pi**2"
    assert Expression("kπ + 1", parameters={"kπ": 3.0}).understood == "kπ + 1"
    assert Expression("π", parameters={"π": 3.0}).evaluate(0.5, 0.5)[0] == 3.0


REFUSED = [
    ("1/2x", 3, "write /(2*x) or /2*x"),
    ("1/2 x", 4, "write /(2*x) or /2*x"),
    ("1/2(x + 1)", 3, "write /(2*(...)) or /2*(...)"),
    ("x/sin(y) t", 9, "write /(sin(y)*t) or /sin(y)*t"),
    ("x/(2) y", 6, "write /((2)*y) or /(2)*y"),
    ("x÷y²t", 4, "write ÷(y²*t) or ÷y²*t"),
    ("1/2|x|", 3, "can be read in two ways"),
    ("e^2x", 3, "write ^(2*x) or ^2*x"),
    ("e^-x y", 5, "write ^(-x*y) or ^-x*y"),
    ("10^-3x", 5, "write ^(-3*x) or ^-3*x"),
    ("2**x y", 5, "write **(x*y) or **x*y"),
    ("2^x^2y", 5, "can be read in two ways"),
    ("x²^3", 2, "write for instance (x**2)**3"),
    ("sin x y", 6, "write sin(x*y) or sin(x)*y"),
    ("sin 2x", 5, "write sin(2*x) or sin(2)*x"),
    ("sin 2π", 5, "write sin(2*π) or sin(2)*π"),
    ("sin pi*x", 6, "write sin(pi*...) or sin(pi)*..."),
    ("sin x/2", 5, "write sin(x/...) or sin(x)/..."),
    ("sin x^2", 5, "write sin(x^...) or sin(x)^..."),
    ("sin x²", 5, "write sin(x²) or sin(x)²"),
    ("sin x cos y", 6, "write sin(x*cos) or sin(x)*cos"),
    ("tanh 20(x - y)", 7, "write tanh(20*(...)) or tanh(20)*(...)"),
    ("sin cos x", 4, "write sin(...), with its argument in brackets"),
    ("hypot x", 6, "write hypot(...), with its argument in brackets"),
    ("sin -x", 0, "write sin(...)"),
    ("sin|x|", 0, "write sin(...)"),
    ("sin^2(x)", 3, "write sin(x)**2"),
    ("sin²(x)", 3, "write sin(x)**2"),
    ("|x|y|t|", 3, "write |...|*y, or abs(...)"),
    ("|x|(y)", 3, "a product behind a bar needs its sign"),
    ("|x||y|", 3, "a product behind a bar needs its sign"),
    ("x | y", 2, "inside where(...) write or"),
    ("where(x < 1 | y < 1, 1, 2)", 12, "inside where(...) write or"),
    ("(|x)|", 1, "never closed"),
    ("|x", 0, "never closed"),
    ("||", 1, "never closed"),
    ("|x|)", 3, "closes nothing"),
    ("x 2", 2, "write x*2 for a product, x**2 for a power"),
    ("(x)2", 3, "for a power"),
    ("2 3", 2, "write 2*3 for a product"),
    ("1.2.3", 3, "write 1.2*.3"),
    ("x\ny", 2, "on the next line"),
    ("sin(x)\ncos(y)", 7, "on the next line"),
    ("e(x)", 1, "exp(...)"),
    ("2e-x", 1, "write 2*e for a product"),
    ("2e", 1, "write 2*e for a product"),
    ("2 x — y", 4, "plain minus sign"),
    ("3 x y z", 6, "not a known name"),
]


@pytest.mark.parametrize(("text", "offset", "words"), REFUSED)
def test_refused_where_it_is_not_clear(text: str, offset: int, words: str) -> None:
    check_refused_at(text, offset, words)


def test_places_in_messages_are_those_of_the_text_that_was_typed() -> None:
    text = "2π|x| − np.sin x + 3 log(y - 1)"
    with pytest.raises(ExpressionError, match=r"because of log\(y - 1\)") as caught:
        Expression(text).check_finite()
    assert caught.value.position.offset == text.index("log")


@pytest.mark.parametrize(
    "text",
    [
        "x²" * 2000,
        "2x " * 1300,
        "|" * 4000,
        "|x|*" * 1000 + "x",
        "np." * 1300 + "x",
        "sin x+" * 600 + "x",
        "x " * 2000,
        "2(" * 2000,
        "⁻²" * 2000,
        "(x)" * 1300,
        "e" * 4096,
        "ee " * 1300,
    ],
)
def test_long_texts_are_refused_quickly(text: str) -> None:
    start = time.process_time()
    assert refusal(text) is not None
    assert time.process_time() - start < 20.0


def test_what_was_understood_is_no_longer_than_the_limit() -> None:
    text = "+".join(["|x|"] * 300)
    padded = text + " " * (LIMITS.length - len(text))
    assert refusal(text) is None
    error = refusal(padded)
    assert "with all its signs" in error.message


@seeded
@given(tree=trees, blanks=st.integers(0, 2**32))
def test_a_formula_of_the_language_is_left_alone(tree: Tree, blanks: int) -> None:
    """Whatever the blanks are, and however few brackets there are."""
    chance = random.Random(blanks)
    spread = "".join(token + chance.choice([" ", "\n", "\t "]) for token in write(tree) if token)
    for text in (spread, sparse_text(tree)):
        assert Expression(text, parameters=PARAMETERS).understood == text


HUMAN = {"*": ["·", "×", " ", "", "⋅"], "**": ["^", " ^ "], "-": ["−", "–"], "/": ["÷"], "<=": ["≤"], ">=": ["≥"]}


@settings(seeded, max_examples=80)
@given(tree=trees, choices=st.integers(0, 2**32))
def test_a_formula_means_the_same_however_it_is_typed(tree: Tree, choices: int) -> None:
    """It may be refused where it is not clear; then it is refused as any other."""
    chance, typed = random.Random(choices), list[str]()
    tokens = [token for token in write(tree) if token]
    for before, token, after in zip(["", *tokens], tokens, [*tokens[1:], ""], strict=False):
        other = chance.choice(HUMAN.get(token, [f"np.{token}"] if token in ("sin", "sqrt", "where", "pi") else [token]))
        joins = other.strip() == "" and before[-1:].isdigit() and after[:1].isdigit()  # ``2*2`` is not ``22``
        typed.append(token if joins else chance.choice([token, other]))
    text, plain = chance.choice(["", " "]).join(typed), " ".join(tokens)
    if refusal(text) is None:
        found, meant = (Expression(each, parameters={"k": 0.75}, t=0.3) for each in (text, plain))
        x, y = np.linspace(0, 1, 7), np.linspace(1, 0, 7) ** 2
        np.testing.assert_array_equal(found.evaluate(x, y, order=1), meant.evaluate(x, y, order=1))


WORDS = [
    *"xyte()+-*/<>,.=^|&² \n0123456789π−·×⁻",
    *("**", "<=", "1e5", "where(", "and", "or", "not", "sin(", "sin", "max(", "np.", "ln", "|x|", "2x", "k", "(x)"),
    *("e^", "1/", "sqrt", "log10", "abs(", "where(x<1,", "j", "\u00a0"),
]


@settings(seeded, max_examples=80)
@given(words=st.lists(st.sampled_from(WORDS), max_size=9), space=st.sampled_from(["", " "]))
def test_what_was_understood_is_a_formula_of_the_language(words: list[str], space: str) -> None:
    """Any text is refused with a place, or it is read; as it was understood it is read again, and the same."""
    text = space.join(words)
    if refusal(text) is not None:
        return
    found = Expression(text, parameters={"k": 0.75}, t=0.3)
    again = Expression(found.understood, parameters={"k": 0.75}, t=0.3)
    assert again.understood == found.understood
    np.testing.assert_array_equal(found.evaluate(0.3, 0.6, order=2), again.evaluate(0.3, 0.6, order=2))


# The pieces of a text: their spelling in the language, and the place where each was typed.


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("x^2", [("name", "x", 0, 1), ("sign", "**", 1, 2), ("number", "2", 2, 3)]),
        ("np.arcsin(x)", [("name", "asin", 0, 9), ("sign", "(", 9, 10), ("name", "x", 10, 11), ("sign", ")", 11, 12)]),
        ("x⁻¹²", [("name", "x", 0, 1), ("raised", "-12", 1, 4)]),
        ("a²b", [("name", "a", 0, 1), ("raised", "2", 1, 2), ("name", "b", 2, 3)]),
        ("2e3", [("number", "2e3", 0, 3)]),
        ("2e", [("number", "2", 0, 1), ("name", "e", 1, 2)]),
        ("x\u00a0\u2009y", [("name", "x", 0, 1), ("name", "y", 3, 4)]),
    ],
)
def test_a_piece_keeps_its_place(text: str, pieces: list[tuple[str, str, int, int]]) -> None:
    assert [(piece.kind, piece.text, piece.start, piece.end) for piece in scan(text, ("x", "y"))] == pieces


@pytest.mark.parametrize("sign", "×·⋅∙∗÷∕⁄−–‐‑≤≥≠^")
def test_signs_of_printed_formulas_have_a_sign_of_the_language(sign: str) -> None:
    (piece,) = scan(sign, ())
    assert piece.text.isascii()
    assert piece.text in ("*", "/", "-", "<=", ">=", "!=", "**")


def test_names_that_are_known_stay_what_they_are() -> None:
    assert [piece.text for piece in scan("π ln np.pi", ())] == ["pi", "log", "pi"]
    assert [piece.text for piece in scan("π ln np.pi", ("π", "ln"))] == ["π", "ln", "pi"]


@pytest.mark.parametrize("text", ["x — y", "√x", "½", "x ⁻ y", "ⅹ\u200b"])
def test_other_characters_are_refused_in_their_place(text: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        list(scan(text, ()))
    place = caught.value.position
    assert not text[place.offset].isascii()


def test_names_of_characters_and_short_texts() -> None:
    assert describe("$") == "'$'"
    assert describe("\u200b") == "(U+200B ZERO WIDTH SPACE)"
    assert shorten("a\n b") == "a b"
    assert len(shorten("x" * 100)) == 40
