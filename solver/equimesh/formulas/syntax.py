"""From text to a list of operations: a whitelist over Python's syntax tree. The text is never run.

The tree is that of the tokens with one space between them, so that a node starts and ends where a token does. From this
follows the place of every operation in the text, in characters.
"""

import ast
import threading
from collections.abc import Collection
from dataclasses import dataclass
from typing import NoReturn

from equimesh.errors import ExpressionError
from equimesh.formulas.spelling import written
from equimesh.formulas.tokens import tokenize
from equimesh.formulas.typed import Token, refuse
from equimesh.formulas.vocabulary import ARGUMENTS, FUNCTIONS, LIMITS, PLANE, Language

# Threads of Python 3.11 that build syntax trees at once share a count of depth, which may end in a SystemError.
_PARSING = threading.Lock()
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
    :data:`~equimesh.formulas.functions.OPERATIONS`.
    """

    name: str
    arguments: tuple[int, ...]
    start: int
    end: int
    value: float = 0.0
    symbol: str = ""


@dataclass(frozen=True, slots=True)
class Parsed:
    """The ``operations`` of an expression in the order of evaluation, the result last; and it in the language."""

    operations: list[Operation]
    understood: str


def parse(text: str, names: Collection[str], language: Language = PLANE) -> Parsed:
    """The operations of ``text``, and the text as it was understood.

    ``names`` are those that may occur, in addition to the functions of :data:`~equimesh.formulas.vocabulary.FUNCTIONS`.
    Raises :class:`~equimesh.errors.ExpressionError`, which carries the position, for everything else.
    """
    tokens = tokenize(text, names, language)
    understood = written(text, tokens)
    if len(understood) > LIMITS.length:
        refuse(text, 0, f"the expression is longer than {LIMITS.length} characters with all its signs: simplify it")
    try:
        with _PARSING:
            tree = ast.parse(" ".join(token.text for token in tokens), mode="eval")
        walk = _Walk(text, tokens, names, language)
        walk.quantity(tree.body, 0)
    except ExpressionError:
        raise
    except (SyntaxError, ValueError, RecursionError, MemoryError, OverflowError) as error:
        at = getattr(error, "offset", None) or 1  # what tokenize lets through, and the parser's own bounds
        what = "cannot be read here" if isinstance(error, SyntaxError) else "is too large or too deeply nested"
        refuse(text, _place(tokens, at), f"the expression {what}: simplify it")
    return Parsed(walk.operations, understood)


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
