"""The arithmetic of an expression, written down while it is done with numbers that are not known yet.

The rules for derivatives are written once, for arrays. A :class:`Traced` takes the place of an array: each operation on
it gives another one, and adds a line to the list of all operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from equimesh.formulas import arithmetic

Operand: TypeAlias = "Traced | float"

CODES: Mapping[Callable[..., Any], int] = MappingProxyType(
    {
        np.add: arithmetic.ADD,
        np.subtract: arithmetic.SUBTRACT,
        np.multiply: arithmetic.MULTIPLY,
        np.divide: arithmetic.DIVIDE,
        np.negative: arithmetic.NEGATE,
        np.absolute: arithmetic.ABSOLUTE,
        np.sqrt: arithmetic.SQRT,
        np.less: arithmetic.LESS,
        np.less_equal: arithmetic.LESS_EQUAL,
        np.greater: arithmetic.GREATER,
        np.greater_equal: arithmetic.GREATER_EQUAL,
        np.equal: arithmetic.EQUAL,
        np.not_equal: arithmetic.NOT_EQUAL,
        np.logical_and: arithmetic.AND,
        np.bitwise_and: arithmetic.AND,
        np.logical_or: arithmetic.OR,
        np.logical_not: arithmetic.NOT,
        np.where: arithmetic.WHERE,
    }
)
"""The operations that are instructions; all others are calls of numpy."""


@dataclass(frozen=True)
class Line:
    """An operation: the code of an instruction or a function of numpy, the row that it writes, and its operands.

    Operands are rows, or numbers.
    """

    operation: int | Callable[..., Any]
    target: int
    operands: tuple[int | float, ...]


@dataclass(eq=False)
class Trace:
    """The operations in their order. Each writes a row of its own, from ``FIRST_FREE`` on."""

    lines: list[Line] = field(default_factory=list)

    def add(self, function: Callable[..., Any], operands: Sequence[Any]) -> Traced:
        """One more operation."""
        known = tuple(part.row if isinstance(part, Traced) else float(part) for part in operands)
        self.lines.append(Line(CODES.get(function, function), arithmetic.FIRST_FREE + len(self.lines), known))
        return Traced(self, self.lines[-1].target)

    def needed(self, results: Iterable[int]) -> list[Line]:
        """The lines on which the rows ``results`` depend."""
        rows, found = set(results), list[Line]()
        for line in reversed(self.lines):
            if line.target in rows:
                found.append(line)
                rows.update(part for part in line.operands if isinstance(part, int))
        return found[::-1]


class Traced(NDArrayOperatorsMixin):
    """Numbers at all points that are not known yet: a ``row`` of a trace."""

    def __init__(self, trace: Trace, row: int) -> None:
        self.trace, self.row = trace, row

    def __array_ufunc__(self, function: Any, method: str, *operands: Any, **options: Any) -> Any:
        """Any function of numpy that works number by number."""
        if method != "__call__" or options:
            return NotImplemented
        return self.trace.add(function, operands)

    def __array_function__(self, function: Any, types: Any, operands: Any, options: Any) -> Any:
        """A choice; and the question whether a condition holds anywhere, which is answered as if it did."""
        if function is np.any:
            return True
        return self.trace.add(function, operands) if function is np.where else NotImplemented


def compact(lines: Sequence[Line], results: Sequence[int]) -> tuple[list[Line], list[int], int]:
    """The same lines with as few rows as possible, the rows of the ``results``, and how many rows there are.

    A row is used again when it is not read any more. No line writes a row that it reads.
    """
    last = {part: number for number, line in enumerate(lines) for part in line.operands if isinstance(part, int)}
    rows, free, count = {arithmetic.X: arithmetic.X, arithmetic.Y: arithmetic.Y}, list[int](), arithmetic.FIRST_FREE
    found = []
    for number, line in enumerate(lines):
        if not free:
            free.append(count)
            count += 1
        rows[line.target] = free.pop()
        operands = tuple(rows[part] if isinstance(part, int) else part for part in line.operands)
        found.append(Line(line.operation, rows[line.target], operands))
        for part in {part for part in line.operands if isinstance(part, int)}:
            if last[part] == number and part >= arithmetic.FIRST_FREE and part not in results:
                free.append(rows[part])
    return found, [rows[row] for row in results], count
