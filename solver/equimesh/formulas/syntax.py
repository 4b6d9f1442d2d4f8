"""From text to a list of operations: a whitelist over Python's syntax tree. The text is never run.

The tree is that of the tokens with one space between them, so that a node starts and ends where a token does. From this
follows the place of every operation in the text, in characters.
"""

from __future__ import annotations

import ast
import difflib
import keyword
import math
import re
import unicodedata
from collections.abc import Collection
from dataclasses import dataclass
from typing import NoReturn

from equimesh.errors import ExpressionError
from equimesh.formulas.spelling import Token, describe, refuse, shorten, skip_space, spell, written
from equimesh.formulas.vocabulary import ARGUMENTS, FUNCTIONS, LIMITS, OTHER_NAMES, PLANE, Language
from equimesh_coupling.errors import PARSING

# The tokens of an expression, each checked in its place: typing errors are found and explained here.
#
# Text that passes has balanced brackets, alternating operands and operators, and only known names. Python's own
# parser, which reads it next, then has nothing left to refuse.

# A name as long as this, or longer, is not taken apart.
_MAX_GLUED = 13


def tokenize(text: str, names: Collection[str], language: Language = PLANE) -> list[Token]:
    """The tokens of ``text``, in which ``names`` stand for variables, constants and parameters.

    Raises :class:`~equimesh.errors.ExpressionError` at the first place that cannot belong to an expression.
    """
    if len(text) > LIMITS.length:
        refuse(text, LIMITS.length, f"the expression is longer than {LIMITS.length} characters")
    reader = _Reader(text, names, language)
    for token in spell(text, names):
        reader.take(token)
    reader.finish()
    return reader.tokens


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
            refuse(self.text, self.last.end, f"something is missing after '{self._typed(self.last)}'")
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
            refuse(self.text, token.start, f"something is missing before '{self._typed(token)}'")
        else:
            before = self._typed(self.last) if self.last else ""
            what = f"between '{before}' and '{self._typed(token)}'"
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
        elif token.text == "not":
            refuse(self.text, token.start, f"'not' cannot follow '{self._typed(last)}'")

    def _typed(self, token: Token) -> str:
        return shorten(self.text[token.start : token.end]) or token.text

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
        name, follows = token.text, self.text[skip_space(self.text, token.end) :][:1]
        if name not in FUNCTIONS and name not in self.names:
            if follows == ".":
                shown = shorten(name)
                refuse(self.text, token.start, f"'{shown}.' is not known: write sin(x), not {shown}.sin(x)")
            refuse(self.text, token.start, self._unknown(name, is_call=follows == "("))

    def _unknown(self, name: str, *, is_call: bool) -> str:
        """The fault of a name that is not known, and the name that was probably meant."""
        shown, normal = f"'{shorten(name)}'", unicodedata.normalize("NFKC", name)
        if normal != name:
            return f"{shown} is written in look-alike characters: write {shorten(normal)}"
        if name in self.language.foreign:
            return f"{shown} has no meaning here: {self.language.foreign[name]}"
        if name in OTHER_NAMES:
            return f"{shown} is not part of the language: write {OTHER_NAMES[name]}"
        if keyword.iskeyword(name):
            return f"{shown} is a word of Python that is not part of the language: remove it"
        if remedy := self._taken_apart(name, is_call=is_call):
            return f"{shown} is not known: write {remedy}"
        known = [*FUNCTIONS] if is_call else [*self.names, *FUNCTIONS]
        same = [other for other in known if other.casefold() == name.casefold()]
        swapped = [other for other in known if sorted(other) == sorted(name)]  # two letters that changed places
        if close := same or swapped or difflib.get_close_matches(name[:40], known, n=1, cutoff=0.6):
            return f"{shown} is not known: did you mean {close[0]}?"
        for character in name:
            if not character.isascii():
                return f"{shown} is not known: it has the character {describe(character)}"
        listed = shorten(", ".join(known if is_call else self.names), 300)
        if is_call:
            return f"{shown} is not a known function: known are {listed}"
        return f"{shown} is not a known name: known are {listed} and the functions; declare others as parameters"

    def _taken_apart(self, name: str, *, is_call: bool) -> str:
        """What to write for two or three names, functions or numbers without a blank; empty for other names."""
        known = sorted((*self.names, *FUNCTIONS), key=len, reverse=True)
        piece = f"(?:{'|'.join(map(re.escape, known))}|[0-9]+)"
        if len(name) >= _MAX_GLUED or not re.fullmatch(f"{piece}{{2,3}}", name):
            return ""
        first, *others = re.findall(piece, name)
        if first in FUNCTIONS:
            return "" if is_call else f"{first}({'*'.join(others)})"
        if others[-1].isdigit() and len(others) == 1 and first in self.names:
            return f"{first}*{others[0]} for a product, {first}**{others[0]} for a power"
        if any(part in FUNCTIONS for part in others[:-1]) or (others[-1] in FUNCTIONS) is not is_call:
            return ""
        return f"{first}*{'*'.join(others)}{'(...)' if is_call else ' for a product'}"


_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.And: "and",
    ast.Or: "or",
}


@dataclass(frozen=True, slots=True)
class Operation:
    """One step of an expression, applied to the results of earlier steps; its text is ``text[start:end]``.

    ``name`` is ``"number"`` (with ``value``), ``"name"`` (with ``symbol``), or an operation of
    :data:`~equimesh.formulas.jet.OPERATIONS`.
    """

    name: str
    arguments: tuple[int, ...]
    start: int
    end: int
    value: float = 0.0
    symbol: str = ""


@dataclass(frozen=True, slots=True)
class ParsedExpression:
    """The ``operations`` of an expression in the order of evaluation, the result last; and it in the language."""

    operations: list[Operation]
    understood: str


def parse(text: str, names: Collection[str], language: Language = PLANE) -> ParsedExpression:
    """The operations of ``text``, and the text as it was understood.

    ``names`` are those that may occur, in addition to the functions of :data:`~equimesh.formulas.vocabulary.FUNCTIONS`.
    Raises :class:`~equimesh.errors.ExpressionError`, which carries the position, for everything else.
    """
    tokens = tokenize(text, names, language)
    understood = written(text, tokens)
    if len(understood) > LIMITS.length:
        refuse(text, 0, f"the expression is longer than {LIMITS.length} characters with all its signs: simplify it")
    try:
        with PARSING:
            tree = ast.parse(" ".join(token.text for token in tokens), mode="eval")
        walk = _Walk(text, tokens, names, language)
        walk.quantity(tree.body, 0)
    except ExpressionError:
        raise
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError) as error:
        at = getattr(error, "offset", None) or 1  # what tokenize lets through, and the parser's own bounds
        what = "cannot be read here" if isinstance(error, SyntaxError) else "is too large or too deeply nested"
        refuse(text, _place(tokens, at), f"the expression {what}: simplify it")
    return ParsedExpression(walk.operations, understood)


def _place(tokens: list[Token], column: int) -> int:
    """The offset in the text of the token at ``column`` (characters, from 1) of the tokens written out."""
    at = 1
    for token in tokens:
        at += len(token.text) + 1
        if column < at:
            return token.start
    return tokens[-1].start


class _Walk:
    """Visits the tree, children first; each visit appends to ``operations`` and returns the last number."""

    def __init__(self, text: str, tokens: list[Token], names: Collection[str], language: Language) -> None:
        self.text, self.names, self.language = text, names, language
        self.operations: list[Operation] = []
        self.starts: dict[int, int] = {}  # by bytes in the tokens written out, as ast counts
        self.ends: dict[int, int] = {}
        at = 0
        for token in tokens:
            self.starts[at] = token.start
            at += len(token.text.encode())
            self.ends[at] = token.end
            at += 1

    def quantity(self, node: ast.expr, depth: int) -> int:
        """A number at each point."""
        self.bound(node, depth)
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return self.append(node, "number", value=float(value))
            case ast.Name(id=name) if name in self.names:
                return self.append(node, "name", symbol=name)
            case ast.UnaryOp(op=ast.UAdd()):
                return self.quantity(node.operand, depth + 1)
            case ast.UnaryOp(op=ast.USub()):
                return self.append(node, "negative", self.quantity(node.operand, depth + 1))
            case ast.BinOp(op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div() | ast.Pow()):
                return self.binary(node, depth)
            case ast.Call(func=ast.Name(id=name), keywords=[]) if name in FUNCTIONS:
                return self.call(node, name, depth)
            case ast.Compare() | ast.BoolOp() | ast.UnaryOp(op=ast.Not()):
                return self.refuse(node, "a comparison is allowed only in the first argument of where(condition, a, b)")
            case _:
                variables = " and ".join(self.language.variables)
                return self.refuse(node, f"this is not part of the language: write a formula in {variables}")

    def binary(self, node: ast.BinOp, depth: int) -> int:
        """A chain a + b - c ... without recursion along it: a long sum is not a deep one."""
        chain: list[ast.BinOp] = [node]
        while isinstance(chain[-1].left, ast.BinOp) and type(chain[-1].left.op) in _OPERATORS:
            chain.append(chain[-1].left)
        result = self.quantity(chain[-1].left, depth + 1)
        for link in reversed(chain):
            result = self.append(link, _OPERATORS[type(link.op)], result, self.quantity(link.right, depth + 1))
        return result

    def call(self, node: ast.Call, name: str, depth: int) -> int:
        """A function of one or more quantities; the first argument of ``where`` is a condition."""
        least, most = ARGUMENTS.get(name, (1, 1))
        count = len(node.args)
        if count < least or (most is not None and count > most):
            right = f"{least} or more arguments" if most is None else f"{least} argument{'s' * (least > 1)}"
            self.refuse(node, f"{name} takes {right}, not {count}: {FUNCTIONS[name]}")
        first = self.condition if name == "where" else self.quantity
        arguments = [first(node.args[0], depth + 1), *(self.quantity(a, depth + 1) for a in node.args[1:])]
        return self.append(node, name, *arguments)

    def condition(self, node: ast.expr, depth: int) -> int:
        """True or false at each point."""
        self.bound(node, depth)
        match node:
            case ast.Compare():
                operands = [self.quantity(operand, depth + 1) for operand in (node.left, *node.comparators)]
                result = -1
                for k, sign in enumerate(node.ops):
                    if type(sign) not in _OPERATORS:
                        self.refuse(node, "compare with <, <=, >, >=, == or !=")
                    link = self.append(node, _OPERATORS[type(sign)], operands[k], operands[k + 1])
                    result = link if k == 0 else self.append(node, "and", result, link)
                return result
            case ast.BoolOp():
                result = self.condition(node.values[0], depth + 1)
                for value in node.values[1:]:
                    result = self.append(node, _OPERATORS[type(node.op)], result, self.condition(value, depth + 1))
                return result
            case ast.UnaryOp(op=ast.Not()):
                return self.append(node, "not", self.condition(node.operand, depth + 1))
            case _:
                such = self.language.comparison
                return self.refuse(node, f"a condition is needed here: a comparison such as {such}")

    def append(self, node: ast.expr, name: str, *arguments: int, value: float = 0.0, symbol: str = "") -> int:
        if len(self.operations) >= LIMITS.nodes:
            self.refuse(node, f"the expression has more than {LIMITS.nodes} operations: simplify it")
        start, end = self.starts[node.col_offset], self.ends[node.end_col_offset or 0]
        self.operations.append(Operation(name, arguments, start, end, value, symbol))
        return len(self.operations) - 1

    def bound(self, node: ast.expr, depth: int) -> None:
        if depth > LIMITS.depth:
            self.refuse(node, f"the expression is nested more than {LIMITS.depth} levels deep: simplify it")

    def refuse(self, node: ast.expr, message: str) -> NoReturn:
        refuse(self.text, self.starts.get(node.col_offset, 0), message)
