"""How people write formulas, and the same in the language: ``2x`` becomes ``2*x``, and ``|x|`` becomes ``abs(x)``.

This is the one place where a text is rewritten. What was valid in the language itself is left alone. What can be read
in two ways is refused, with both of them in the message. The rules are on the page of expressions.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import NoReturn

from equimesh.errors import ExpressionError, Position
from equimesh.formulas.vocabulary import (
    ARGUMENTS,
    CHARACTER_REMEDIES,
    FUNCTIONS,
    PI,
    RAISED,
    RAISED_MINUS,
    SAME_NAMES,
    SAME_SIGNS,
)

# The pieces of a text as a person typed it: numbers, names and signs, each with the spelling of the language.
#
# A piece keeps its place in the text, whatever its spelling: ``−`` becomes ``-`` and ``np.sin`` becomes ``sin`` here.

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


_AFTER_ARGUMENT = frozenset(("+", "-", "<", "<=", ">", ">=", "==", "!=", "and", "or", ",", ")"))
"""The signs that end the argument of a function without brackets."""


def spell(text: str, names: Collection[str]) -> Iterator[Token]:
    """The tokens of ``text`` in the language, in which ``names`` stand for variables, constants and parameters.

    A token that was not typed has the place of the blanks where it belongs, or no length. Raises
    :class:`~equimesh.errors.ExpressionError` at the first place that can be read in two ways; whether the tokens fit
    together is for :func:`~equimesh.formulas.syntax.tokenize` to check.
    """
    speller = _Speller(text, names)
    for token in scan(text, names):
        yield from speller.take(token)
    yield from speller.finish()


def written(text: str, tokens: Iterable[Token]) -> str:
    """``text`` with the spelling of its ``tokens``, and otherwise as it was typed."""
    parts, at = list[str](), 0
    for token in tokens:
        gap = _ascii(text[at : token.start])
        if not gap and parts and token.text[0].isidentifier() and parts[-1][-1:].isidentifier():
            gap = " "  # not|x|<1
        parts += [gap, token.text]
        at = token.end
    return "".join([*parts, _ascii(text[at:])])


def _ascii(blanks: str) -> str:
    return "".join(blank if blank.isascii() else " " for blank in blanks)


@dataclass(slots=True)
class _Group:
    """What is known inside a bracket, a bar, or the whole text.

    ``unclear`` is a ``/``, or a ``**`` behind a number or e, behind which a product without a sign may belong to the
    right operand or not: 1/2x, e^2x.
    """

    opened: Token | None
    unclear: Token | None = None

    @property
    def is_bar(self) -> bool:
        return self.opened is not None and self.opened.text == "|"


class _Speller:
    """Takes the pieces of a text one by one, and gives the tokens of the language for each."""

    def __init__(self, text: str, names: Collection[str]) -> None:
        self.text, self.names = text, names
        self.groups = [_Group(None)]
        self.last: Token | None = None
        self.is_raised = False  # the last token is the end of a raised number
        self.function: Token | None = None  # whose argument without brackets is the last token

    def take(self, token: Token) -> Iterator[Token]:
        """The tokens for one more piece."""
        if self.function is not None:
            yield self._end_argument(token)
        last = self.last
        if last is not None and last.kind == "name" and last.text in FUNCTIONS:
            yield from self._after_function(last, token)
        elif token.text == "|":
            yield from self._bar(token)
        elif token.kind == "raised":
            yield from self._raised(token)
        else:
            if last is not None and not self._wants_operand and (token.kind != "sign" or token.text == "("):
                yield self._product(last, token)
            yield self._plain(token)

    def finish(self) -> Iterator[Token]:
        """The tokens that are missing at the end."""
        last = self.last
        if self.function is not None:
            yield self._end_argument(None)
        if last is not None and last.kind == "name" and last.text in FUNCTIONS:
            self._refuse_name(last)
        self._require_no_bar()

    @property
    def _wants_operand(self) -> bool:
        return self.last is None or (self.last.kind == "sign" and self.last.text != ")")

    def _give(self, token: Token) -> Token:
        self.last, self.is_raised = token, False
        return token

    def _typed(self, token: Token) -> str:
        return shorten(self.text[token.start : token.end])

    def _plain(self, token: Token) -> Token:
        """A token that stays what it is."""
        group = self.groups[-1]
        if token.kind == "sign" and not self._wants_operand:
            if token.text == "**":
                self._power(group, token)
            elif token.text not in "()":
                group.unclear = token if token.text == "/" else None
        if token.text == "(":
            self.groups.append(_Group(token))
        elif token.text == ")":
            self._require_no_bar()
            if len(self.groups) > 1:
                self.groups.pop()
        return self._give(token)

    def _power(self, group: _Group, token: Token) -> None:
        base = self.last
        if base is None:
            return
        if self.is_raised:
            refuse(self.text, token.start, "a power of a power needs brackets: write for instance (x**2)**3")
        if group.unclear is None and (base.kind == "number" or (base.kind == "name" and base.text == "e")):
            group.unclear = token

    def _raised(self, token: Token) -> Iterator[Token]:
        """An exponent in small raised characters: it ends where they end."""
        yield self._give(Token("sign", "**", token.start, token.start))
        if token.text.startswith("-"):
            yield self._give(Token("sign", "-", token.start, token.start))
        yield self._give(Token("number", token.text.removeprefix("-"), token.start, token.end))
        self.is_raised = True

    def _product(self, last: Token, token: Token) -> Token:
        """The sign of a product that was typed without one."""
        left, right = self._typed(last), self._typed(token)
        touches, message = last.end == token.start, ""
        if last.kind == "number" and touches and token.text in ("j", "J") and token.text not in self.names:
            refuse(self.text, last.start, "complex numbers are not part of the language")
        if last.kind == "number" and touches and token.text[0] == "_":
            message = "a number is written without _ between its digits"
        elif token.kind == "name" and token.text not in self.names and token.text not in FUNCTIONS:
            pass  # refused next, for its name
        elif token.kind == "number":
            power = "" if last.kind == "number" else f", {left}**{right} for a power"
            message = f"no operator between '{left}' and '{right}': write {left}*{right} for a product{power}"
        elif left == "|":
            message = f"a product behind a bar needs its sign: write |...|*{right}, or abs(...) for one inside another"
        elif "\n" in self.text[last.end : token.start]:
            message = f"no operator between '{left}' and '{right}' on the next line: write {left}*{right} for a product"
        elif token.text == "(" and last.kind == "name" and last.text == "e":
            message = "e is a number: write e*(...) for a product, exp(...) for the exponential function"
        elif last.kind == "number" and token.text == "e" and touches and self._follows(token) in "+-":
            message = f"{left}e may be a number without its end: write {left}*e for a product"
        else:
            self._require_clear(last, token)
        if message:
            refuse(self.text, token.start, message)
        return self._give(Token("sign", "*", last.end, token.start))

    def _follows(self, token: Token) -> str:
        """The character behind a token, in the language; empty at the end of the text."""
        at = skip_space(self.text, token.end)
        return SAME_SIGNS.get(self.text[at : at + 1], self.text[at : at + 1])

    def _require_clear(self, last: Token, token: Token) -> None:
        """Refuse a product whose place behind a quotient or in an exponent is not clear."""
        group = self.groups[-1]
        sign = group.unclear
        if sign is not None and (sign.text == "/" or last.text != ")"):
            shown, operand, more = self._typed(sign), shorten(self.text[sign.end : last.end]), self._continuation(token)
            both = f"{shown}({operand}{more}) or {shown}{operand}{more}"
            typed = shorten(self.text[sign.start : token.end])
            refuse(self.text, token.start, f"'{typed}' can be read in two ways: write {both}")
        group.unclear = None

    def _bar(self, token: Token) -> Iterator[Token]:
        """A bar opens an absolute value where an operand is missing, and closes the one that is open elsewhere."""
        if not self._wants_operand and self._closes_bar(token):
            self.groups.pop()
            yield self._give(Token("sign", ")", token.start, token.end))
            return
        if self.last is not None and not self._wants_operand:
            yield self._product(self.last, token)
        self.groups.append(_Group(token))
        yield self._give(Token("name", "abs", token.start, token.start))
        yield self._give(Token("sign", "(", token.start, token.end))

    def _require_no_bar(self) -> None:
        opened = self.groups[-1].opened
        if opened is not None and opened.text == "|":
            remedy = "add '|' behind an absolute value; inside where(...) write or"
            refuse(self.text, opened.start, f"this '|' is never closed: {remedy}")

    def _after_function(self, function: Token, token: Token) -> Iterator[Token]:
        """The bracket of a function, or its argument without one: one number or one name."""
        if token.text == "(":
            yield self._plain(token)
            return
        if token.kind == "raised" or token.text == "**":
            refuse(self.text, token.start, f"a power of a function follows its argument: write {function.text}(x)**2")
        if token.kind == "sign":
            self._refuse_name(function)
        if token.text in FUNCTIONS or ARGUMENTS.get(function.text, (1, 1))[0] != 1:
            refuse(self.text, token.start, f"write {function.text}(...), with its argument in brackets")
        self.function = function
        yield self._give(Token("sign", "(", function.end, token.start))
        yield self._give(token)

    def _end_argument(self, token: Token | None) -> Token:
        """The bracket behind an argument without one, where it is clear that the argument ends before ``token``."""
        start, end = (0, 0) if self.last is None else (self.last.start, self.last.end)
        if token is not None and token.text not in _AFTER_ARGUMENT and not self._closes_bar(token):
            name = "" if self.function is None else self.function.text
            argument, more = shorten(self.text[start:end]), self._continuation(token)
            message = (
                f"'{more}' may belong to {name} or not: write {name}({argument}{more}) or {name}({argument}){more}"
            )
            refuse(self.text, token.start, message)
        self.function = None
        return self._give(Token("sign", ")", end, end))

    def _continuation(self, token: Token) -> str:
        """An operand or operator behind an operand, as it could be written there."""
        right = {"(": "(...)", "|": "|...|"}.get(token.text, self._typed(token))
        if token.kind == "raised":
            return right
        return f"*{right}" if token.kind != "sign" or token.text in "(|" else f"{right}..."

    def _closes_bar(self, token: Token) -> bool:
        return token.text == "|" and self.groups[-1].is_bar

    def _refuse_name(self, function: Token) -> None:
        refuse(self.text, function.start, f"{function.text} is a function: write {function.text}(...)")
