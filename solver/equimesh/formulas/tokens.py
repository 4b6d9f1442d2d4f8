"""The tokens of an expression, each checked in its place: typing errors are found and explained here.

Text that passes has balanced brackets, alternating operands and operators, and only known names. Python's own parser,
which reads it next, then has nothing left to refuse.
"""

import difflib
import keyword
import math
import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass
from typing import NoReturn

from equimesh.errors import ExpressionError, Position
from equimesh.formulas.vocabulary import CHARACTER_REMEDIES, FUNCTIONS, LIMITS, OTHER_NAMES, PLANE, Language

_NUMBER = re.compile(r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_WORD = re.compile(r"\w+")
_OPERATOR = re.compile(r"\*\*|<=|>=|==|!=|[-+*/<>(),]")
_SPACE = re.compile(r"[ \t\r\n]*")
_BINARY = frozenset(("+", "-", "*", "/", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or"))


@dataclass(frozen=True, slots=True)
class Token:
    """A number, a name or a sign (operator, bracket, comma, ``and``, ``or``, ``not``) and where it starts."""

    kind: str  # "number", "name" or "sign"
    text: str
    start: int

    @property
    def end(self) -> int:
        """Offset behind the last character."""
        return self.start + len(self.text)


def refuse(text: str, offset: int, message: str) -> NoReturn:
    """Raise :class:`~equimesh.errors.ExpressionError` at ``offset`` (in characters, from 0)."""
    line = text.count("\n", 0, offset) + 1
    column = offset - (text.rfind("\n", 0, offset) + 1) + 1
    raise ExpressionError(message, position=Position(offset, line, column), field="expression")


def tokenize(text: str, names: Collection[str], language: Language = PLANE) -> list[Token]:
    """The tokens of ``text``, in which ``names`` stand for variables, constants and parameters.

    Raises :class:`~equimesh.errors.ExpressionError` at the first place that cannot belong to an expression.
    """
    if len(text) > LIMITS.length:
        refuse(text, LIMITS.length, f"the expression is longer than {LIMITS.length} characters")
    reader = _Reader(text, names, language)
    offset = _skip_space(text, 0)
    while offset < len(text):
        token = _token_at(text, offset)
        reader.take(token)
        offset = _skip_space(text, token.end)
    reader.finish()
    return reader.tokens


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


def _skip_space(text: str, offset: int) -> int:
    match = _SPACE.match(text, offset)
    return match.end() if match else offset


def _token_at(text: str, offset: int) -> Token:
    if match := _NUMBER.match(text, offset):
        return Token("number", match.group(), offset)
    word = match.group() if (match := _WORD.match(text, offset)) else ""
    while word and not word.isidentifier():  # \w also has superscripts and the digits of other scripts
        word = word[:-1]
    if word:
        return Token("sign" if word in ("and", "or", "not") else "name", word, offset)
    pair = text[offset : offset + 2]
    if pair not in CHARACTER_REMEDIES and (match := _OPERATOR.match(text, offset)):
        return Token("sign", match.group(), offset)
    sign = pair if pair in CHARACTER_REMEDIES else text[offset]
    shown = describe(sign) if len(sign) == 1 else f"'{sign}'"
    return refuse(text, offset, f"{shown} does not belong in an expression: {_character_remedy(sign)}")


def _character_remedy(sign: str) -> str:
    plain = unicodedata.normalize("NFKC", sign)
    if plain.isspace():
        return "use an ordinary space"
    return CHARACTER_REMEDIES.get(sign, f"write {plain}" if plain != sign and plain.isascii() else "remove it")


class _Reader:
    """Reads the tokens one by one; tracks whether an operand must follow, and which brackets are open."""

    def __init__(self, text: str, names: Collection[str], language: Language) -> None:
        self.text, self.names, self.language = text, names, language
        self.tokens: list[Token] = []
        self.open: list[tuple[Token, bool]] = []  # and whether it holds the arguments of a function
        self.signs = 0  # signs in a row in front of an operand

    @property
    def last(self) -> Token | None:
        return self.tokens[-1] if self.tokens else None

    @property
    def wants_operand(self) -> bool:
        return self.last is None or (self.last.kind == "sign" and self.last.text != ")")

    def take(self, token: Token) -> None:
        if self.wants_operand:
            self._operand(token)
        else:
            self._operator(token)
        self.tokens.append(token)

    def finish(self) -> None:
        if self.last is None:
            refuse(self.text, 0, f"the expression is empty: write for instance {self.language.example}")
        if self.wants_operand:
            refuse(self.text, self.last.end, f"something is missing after '{self.last.text}'")
        if self.open:
            refuse(self.text, self.open[-1][0].start, "this '(' is never closed: add ')'")

    def _operand(self, token: Token) -> None:
        previous = self.last.text if self.last else ""
        if token.kind == "number":
            self._number(token)
        elif token.kind == "name":
            self._name(token)
        elif token.text == "(":
            self._push(token, is_call=False)
        elif token.text in ("+", "-", "not"):
            if token.text == "not" and previous not in ("", "(", ",", "and", "or", "not"):
                refuse(self.text, token.start, f"'not' cannot follow '{previous}': put it in brackets")
            self.signs += 1
            self._check_depth(token)
            return
        elif token.text == ")" and previous == "(" and self.open[-1][1]:
            self.open.pop()  # no arguments: the parser refuses this with the right number
        elif previous == "":
            refuse(self.text, token.start, f"something is missing before '{token.text}'")
        else:
            what = f"between '{previous}' and '{token.text}'"
            refuse(self.text, token.start, f"a number, a name or a bracket is missing {what}")
        self.signs = 0

    def _operator(self, token: Token) -> None:
        last = self.tokens[-1]
        if token.text == "(" and last.kind == "name" and last.text in FUNCTIONS:
            self._push(token, is_call=True)
        elif token.text == ")":
            if not self.open:
                refuse(self.text, token.start, "this ')' closes nothing: remove it, or add '('")
            self.open.pop()
        elif token.text == ",":
            if not (self.open and self.open[-1][1]):
                remedy = "a comma separates the arguments of a function; decimals take a point, as in 0.5"
                refuse(self.text, token.start, f"',' is out of place: {remedy}")
        elif token.text not in _BINARY:
            self._missing_operator(last, token)

    def _missing_operator(self, last: Token, token: Token) -> NoReturn:
        if token.text == "not":
            refuse(self.text, token.start, f"'not' cannot follow '{shorten(last.text)}'")
        if keyword.iskeyword(token.text):
            self._name(token)
        if last.kind == "name" and last.text in FUNCTIONS:
            refuse(self.text, token.start, f"write {last.text}(...), with its argument in brackets")
        if last.kind == "number" and token.text in ("j", "J") and last.end == token.start:
            refuse(self.text, last.start, "complex numbers are not part of the language")
        if last.kind == "number" and token.text[0] == "_" and last.end == token.start:
            refuse(self.text, token.start, "a number is written without _ between its digits")
        left, right = shorten(last.text), shorten(token.text)
        refuse(
            self.text,
            token.start,
            f"no operator between '{left}' and '{right}': write {left}*{right} for a product",
        )

    def _push(self, token: Token, *, is_call: bool) -> None:
        self.open.append((token, is_call))
        self._check_depth(token)
        self.signs = 0

    def _check_depth(self, token: Token) -> None:
        if self.signs + len(self.open) > LIMITS.depth:
            message = f"the expression is nested more than {LIMITS.depth} levels deep: simplify it"
            refuse(self.text, token.start, message)

    def _number(self, token: Token) -> None:
        if len(token.text) > LIMITS.digits:
            refuse(self.text, token.start, f"the number has more than {LIMITS.digits} characters: round it")
        if not math.isfinite(float(token.text)):
            refuse(self.text, token.start, f"the number {token.text} is too large: the largest is about 1.8e308")
        if token.text.isdigit() and token.text[0] == "0" and token.text.strip("0"):
            refuse(
                self.text,
                token.start,
                f"the number {token.text} starts with 0: write {token.text.lstrip('0')}",
            )

    def _name(self, token: Token) -> None:
        name, follows = token.text, self.text[_skip_space(self.text, token.end) :][:1]
        if name in FUNCTIONS:
            if follows != "(" and (follows in "+-*/<>=!)," or not follows):
                refuse(self.text, token.start, f"{name} is a function: write {name}(...)")
        elif name not in self.names:
            if follows == ".":
                refuse(self.text, token.start, f"'{shorten(name)}.' is not known: write sin(x), not np.sin(x)")
            refuse(self.text, token.start, self._unknown(name, is_call=follows == "("))

    def _unknown(self, name: str, *, is_call: bool) -> str:
        """What is wrong with a name that is not known, and what was probably meant."""
        shown, normal = f"'{shorten(name)}'", unicodedata.normalize("NFKC", name)
        if normal != name:
            return f"{shown} is written in look-alike characters: write {shorten(normal)}"
        if name in self.language.foreign:
            return f"{shown} has no meaning here: {self.language.foreign[name]}"
        if name in OTHER_NAMES:
            return f"{shown} is not part of the language: write {OTHER_NAMES[name]}"
        if keyword.iskeyword(name):
            return f"{shown} is a word of Python that is not part of the language: remove it"
        if not is_call and 1 < len(name) <= 3 and all(letter in self.names for letter in name):
            return f"{shown} is not known: write {'*'.join(name)} for a product"
        known = [*FUNCTIONS] if is_call else [*self.names, *FUNCTIONS]
        same = [other for other in known if other.casefold() == name.casefold()]
        if close := same or difflib.get_close_matches(name[:40], known, n=1, cutoff=0.6):
            return f"{shown} is not known: did you mean {close[0]}?"
        for character in name:
            if not character.isascii():
                return f"{shown} is not known: it has the character {describe(character)}"
        listed = shorten(", ".join(known if is_call else self.names), 300)
        if is_call:
            return f"{shown} is not a known function: known are {listed}"
        return f"{shown} is not a known name: known are {listed} and the functions; declare others as parameters"
