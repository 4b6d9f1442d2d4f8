"""Jets: parts that vanish by structure cost nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from equimesh.fields.expression import FUNCTIONS
from equimesh.formulas.jet import OPERATIONS, constant, coordinates
from solver.formulas.random_formulas import Tree, refusal, seeded, trees, write
from solver.formulas.texts import check_refused_at, refused


def test_structural_zeros_cost_nothing() -> None:
    x, y = coordinates(np.array([0.5]), np.array([0.25]))
    u = OPERATIONS["sin"](OPERATIONS["*"](constant(15.0), x, 2), 2)
    assert u.gradient[1] is None
    assert u.hessian[1:] == (None, None)
    assert OPERATIONS["*"](constant(15.0), x, 2).gradient[0] == 15.0
    assert OPERATIONS["*"](x, y, 2).hessian == (None, 1.0, None)


# What people mistype is refused at its position, with what to write in its place.


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
    ("(sin)(x)", 1, "write sin(...)"),
    ("1 + sin", 4, "write sin(...)"),
    ("xy", 0, "write x*y"),
    ("xyt", 0, "write x*y*t"),
    ("pix", 0, "write pi*x"),
    ("e2", 0, "write e*2 for a product, e**2 for a power"),
    ("x2", 0, "write x*2 for a product, x**2 for a power"),
    ("sinx", 0, "write sin(x)"),
    ("sin2x", 0, "write sin(2*x)"),
    ("xsin(x)", 0, "write x*sin(...)"),
    ("sinalpha", 0, "write sin(alpha)"),
    ("x^", 2, "missing after '^'"),
    ("x·/y", 2, "missing between '·' and '/'"),
    ("0,5*x", 1, "point"),
    ("snh(x)", 0, "did you mean sinh?"),
    ("tahn(x)", 0, "did you mean tanh?"),
    ("X", 0, "did you mean x?"),
    ("x + alpa", 4, "did you mean alpha?"),
    ("foo(x)", 0, "not a known function"),
    ("z", 0, "not a known name"),
    ("__import__('os')", 0, "not a known function"),
    ("x.real", 1, "point"),
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
    ("scipy.sin(x)", 0, "write sin(x), not scipy.sin(x)"),
    ("1_000", 1, "without _"),
    ("007", 0, "write 7"),
    ("1e400", 0, "too large"),
    ("1" * 41, 0, "40 characters"),
    ("1" * 4000, 0, "40 characters"),
    ("x" + " " * 4096, 4096, "longer than 4096"),
    ("-" * 101 + "x", 100, "nested more than 100"),
    ("where(x is y, 1, 2)", 8, "Python"),
    ("where(x < not y, 1, 2)", 10, "'not'"),
    ("where(x not y, 1, 2)", 8, "'not'"),
    ("x\x00", 1, "U+0000"),
    ("x\ud800", 1, "U+D800"),
    ("x + ｙ", 4, "write y"),
    ("х", 0, "CYRILLIC"),
    ("２*x", 0, "write 2"),
    ("x\u200b", 1, "ZERO WIDTH SPACE"),
]


@pytest.mark.parametrize(("text", "offset", "words"), POSITIONS)
def test_refused_at_its_position(text: str, offset: int, words: str) -> None:
    check_refused_at(text, offset, words)


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [("σ*(\n  σ + é)", 2, 7), ("𝛼", 1, 1), ("σσσ + é", 1, 7), ("x +\r\n\r\n z", 3, 2), ("x\n\n+", 3, 2)],
)
def test_positions_count_characters_and_lines(text: str, line: int, column: int) -> None:
    position = refused(text, σ=1.0, σσσ=2.0).position
    assert (position.line, position.column) == (line, column)


@seeded
@given(tree=trees, where=st.integers(0, 10**6), bad=st.sampled_from(["$", "[", "'x'", "é", "]", ";", "=", "?", "—"]))
def test_a_formula_with_a_foreign_sign_is_refused_there(tree: Tree, where: int, bad: str) -> None:
    tokens = [token for token in write(tree) if token]
    where %= len(tokens) + 1
    before = "".join(f"{token}\n " for token in tokens[:where])
    error = refusal(before + bad + " " + " ".join(tokens[where:]))
    assert error.position is not None
    if not (where and tokens[where - 1] in FUNCTIONS):
        assert error.position.offset == len(before)
        assert (error.position.line, error.position.column) == (where + 1, 2 if where else 1)


@settings(seeded, max_examples=30)
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


@settings(seeded, max_examples=80)
@given(words=st.lists(st.sampled_from(WORDS), max_size=12), space=st.sampled_from(["", " "]))
def test_random_words_are_read_or_refused(words: list[str], space: str) -> None:
    refusal(space.join(words))
