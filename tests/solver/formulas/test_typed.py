"""The pieces of a text: their spelling in the language, and the place where each was typed."""

from __future__ import annotations

import pytest

from equimesh.errors import ExpressionError
from equimesh.formulas.spelling import describe, scan, shorten


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
    assert place is not None
    assert not text[place.offset].isascii()


def test_names_of_characters_and_short_texts() -> None:
    assert describe("$") == "'$'"
    assert describe("\u200b") == "(U+200B ZERO WIDTH SPACE)"
    assert shorten("a\n b") == "a b"
    assert len(shorten("x" * 100)) == 40
