"""The pieces of a text as a person typed it: numbers, names and signs, each with the spelling of the language.

A piece keeps its place in the text, whatever its spelling: ``−`` becomes ``-`` and ``np.sin`` becomes ``sin`` here.
"""

import re
import unicodedata
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import NoReturn

from equimesh.errors import ExpressionError, Position
from equimesh.formulas.vocabulary import CHARACTER_REMEDIES, FUNCTIONS, PI, RAISED, RAISED_MINUS, SAME_NAMES, SAME_SIGNS

_NUMBER = re.compile(r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WORD = re.compile(rf"[^\W{''.join(RAISED)}]+")
_PREFIX = re.compile(r"(?:numpy|np|math)\.(?=[A-Za-z_])")
_OPERATOR = re.compile(r"\*\*|<=|>=|==|!=|[-+*/<>(),|]")
_RAISED = re.compile(f"{RAISED_MINUS}?[{''.join(RAISED)}]+")
_SPACE = re.compile(r"[ \t\r\n\u00a0\u2000-\u200a\u202f\u205f]*")  # with those of printed formulas


@dataclass(frozen=True, slots=True)
class Token:
    """A number, a name, a sign (operator, bracket, bar, comma, ``and``, ``or``, ``not``) or a raised number.

    ``text`` is its spelling in the language; it was typed as ``text[start:end]`` of the expression.
    """

    kind: str  # "number", "name", "sign" or "raised"
    text: str
    start: int
    end: int


def scan(text: str, names: Collection[str]) -> Iterator[Token]:
    """The pieces of ``text`` in their order; ``names`` keep their spelling.

    Raises :class:`~equimesh.errors.ExpressionError` at a character that cannot belong to an expression.
    """
    offset = skip_space(text, 0)
    while offset < len(text):
        token = _token_at(text, offset, names)
        yield token
        offset = skip_space(text, token.end)


def refuse(text: str, offset: int, message: str) -> NoReturn:
    """Raise :class:`~equimesh.errors.ExpressionError` at ``offset`` (in characters, from 0)."""
    line = text.count("\n", 0, offset) + 1
    column = offset - (text.rfind("\n", 0, offset) + 1) + 1
    raise ExpressionError(message, position=Position(offset, line, column), field="expression")


def describe(character: str) -> str:
    """The name of a character in a message: itself when it can be printed, and its Unicode name when not ASCII."""
    if character.isascii() and character.isprintable():
        return f"'{character}'"
    shown = f"'{character}' " if character.isprintable() else ""
    name = unicodedata.name(character, "")
    return f"{shown}(U+{ord(character):04X}{' ' + name if name else ''})"


def shorten(source: str, size: int = 40) -> str:
    """``source`` on one line, cut in the middle to ``size`` characters."""
    line = " ".join(source.split())
    return line if len(line) <= size else f"{line[: size - 13]}...{line[-10:]}"


def skip_space(text: str, offset: int) -> int:
    """The offset of the next character that is not blank."""
    match = _SPACE.match(text, offset)
    return match.end() if match else offset


def _token_at(text: str, offset: int, names: Collection[str]) -> Token:
    if match := _NUMBER.match(text, offset):
        return Token("number", match.group(), offset, match.end())
    prefix = _PREFIX.match(text, offset)
    if word := _word_at(text, prefix.end() if prefix else offset, names):
        kind, end = "sign" if word in ("and", "or", "not") else "name", (prefix.end() if prefix else offset) + len(word)
        same = word if word in names or word in FUNCTIONS else SAME_NAMES.get(word, word)
        return Token(kind, same, offset, end)
    if match := _RAISED.match(text, offset):
        return Token("raised", "".join(RAISED.get(sign, "-") for sign in match.group()), offset, match.end())
    pair = text[offset : offset + 2]
    if pair not in CHARACTER_REMEDIES and (match := _OPERATOR.match(text, offset)):
        return Token("sign", match.group(), offset, match.end())
    if text[offset] in SAME_SIGNS:
        return Token("sign", SAME_SIGNS[text[offset]], offset, offset + 1)
    sign = pair if pair in CHARACTER_REMEDIES else text[offset]
    shown = describe(sign) if len(sign) == 1 else f"'{sign}'"
    return refuse(text, offset, f"{shown} does not belong in an expression: {_character_remedy(sign)}")


def _word_at(text: str, offset: int, names: Collection[str]) -> str:
    """The word at an offset; the letter pi is a word of its own, except in a name that is known."""
    word = match.group() if (match := _WORD.match(text, offset)) else ""
    while word and not word.isidentifier():  # \w also has the digits of other scripts
        word = word[:-1]
    if PI in word and word not in names:
        word = PI if word[0] == PI else word.partition(PI)[0]
    return word


def _character_remedy(sign: str) -> str:
    plain = unicodedata.normalize("NFKC", sign)
    if plain.isspace():
        return "use an ordinary space"
    return CHARACTER_REMEDIES.get(sign, f"write {plain}" if plain != sign and plain.isascii() else "remove it")
