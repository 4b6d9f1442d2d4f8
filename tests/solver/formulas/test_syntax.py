"""From text to operations: what is deep, long or broken is refused at once, and nothing of a text is ever run."""

from __future__ import annotations

import ast
import sys
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import get_ident

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import equimesh.fields.expression as module
from equimesh.errors import ExpressionError
from equimesh.fields.expression import LIMITS, Expression
from equimesh.formulas import vocabulary
from solver.formulas.random_formulas import Tree, refusal, seeded, sparse_text, text_of, trees, write
from solver.formulas.texts import check_refused_at, refused, values

# Of processor time for one refusal: a hundred times what it takes on an idle machine.
MAX_SECONDS = 20.0


POSITIONS = [
    ("9**9**9**9", 6, "exponent"),
    ("x**1001", 3, "exponent"),
    ("x**" * 150 + "x", 300, "nested more than 100"),
    ("x+" * 1000 + "x", 0, "more than 1000 operations"),
    ("x**-1001", 3, "exponent"),
    ("x**(500 + 501)", 4, "exponent"),
    ("x < 1", 0, "where(condition, a, b)"),
    ("1 + (x and y)", 5, "where(condition, a, b)"),
    ("where(x, 1, 2)", 6, "a comparison such as x < 0.5"),
    ("where(x < 1, y < 1, 2)", 13, "where(condition, a, b)"),
    ("where(x < 1, 2)", 0, "3 arguments, not 2"),
    ("sin()", 0, "1 argument, not 0"),
    ("sin(x, y)", 0, "1 argument, not 2"),
    ("1 + min(x)", 4, "2 or more arguments"),
]


@pytest.mark.parametrize(("text", "offset", "words"), POSITIONS)
def test_refused_at_its_position(text: str, offset: int, words: str) -> None:
    check_refused_at(text, offset, words)


def test_positions_of_parsed_parts_count_characters() -> None:
    error = refused("σ +\n σσσ*min(σ)", σ=1.0, σσσ=2.0)  # found by the walk over the tree, not by the tokens
    assert (error.position.offset, error.position.line, error.position.column) == (9, 2, 6)


def test_what_is_long_but_harmless_is_accepted() -> None:
    assert values("+".join(["x*y"] * 200), 0.5, 0.5, 0) == [50.0]
    assert values("(" * 99 + "x" + ")" * 99, 0.5, 0.5, 0) == [0.5]
    assert values("-" * 98 + "x", 0.5, 0.5, 0) == [0.5]
    assert len("1" * LIMITS.digits) == 40
    assert values("1" * 40, 0.5, 0.5, 0) == [float("1" * 40)]


def _reachable_from_text(part: ast.stmt) -> Iterator[ast.AST]:
    """What a formula can lead to: all but the checks of objects that a program hands over as functions."""
    checks = {"require_field", "require_fields"}
    return iter(()) if isinstance(part, ast.FunctionDef) and part.name in checks else ast.walk(part)


def test_nothing_is_ever_run() -> None:
    sources = [Path(module.__file__), *Path(vocabulary.__file__).parent.glob("*.py")]
    assert {"syntax", "program", "expression"} < {source.stem for source in sources}
    for source in sources:
        for node in (node for part in ast.parse(source.read_text()).body for node in _reachable_from_text(part)):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in ("eval", "exec", "compile", "__import__", "getattr") or (
                    source.stem == "syntax" and node.func.id == "getattr"  # the offset of a SyntaxError
                )


@seeded
@given(tree=trees)
def test_precedence_is_that_of_python(tree: Tree) -> None:
    """Without brackets a formula means what it means with all of them."""
    x, y = np.linspace(0, 1, 7), np.linspace(1, 0, 7) ** 2
    sparse, full = (Expression(text, parameters={"k": 0.75}, t=0.3) for text in (sparse_text(tree), text_of(tree)))
    np.testing.assert_array_equal(sparse.evaluate(x, y, order=1), full.evaluate(x, y, order=1))


@seeded
@given(tree=trees, where=st.integers(0, 10**6))
def test_a_formula_without_one_of_its_brackets_is_refused(tree: Tree, where: int) -> None:
    tokens = [token for token in write(tree) if token]
    brackets = [index for index, token in enumerate(tokens) if token in "()"]
    assume(brackets)
    del tokens[brackets[where % len(brackets)]]
    assert refusal(" ".join(tokens)) is not None


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


@settings(seeded, max_examples=80)
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
    for _ in range(3):  # what the interpreter does by itself meanwhile, it does not do each time
        with watched() as events:
            refusal(" ".join(tokens))
        if not events:
            break
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
    assert time.process_time() - started < MAX_SECONDS
    assert 0 <= caught.value.position.offset <= len(text)


HEARD: list[list[str]] = []


def hear(event: str, _: tuple[object, ...]) -> None:
    # Other threads of the process of tests may open files meanwhile.
    if (
        HEARD
        and get_ident() == HEARS
        and event in ("exec", "import", "open", "os.system", "subprocess.Popen", "socket.connect")
    ):
        HEARD[-1].append(event)


HEARS = get_ident()


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
