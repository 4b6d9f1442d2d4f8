"""An expression ready for many points: runs of compiled arithmetic, and functions of numpy between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from equimesh.formulas import arithmetic
from equimesh.formulas.jet import Component
from equimesh.formulas.trace import Line, Trace, Traced, compact
from equimesh.numerics.types import Array

# Numbers in the memory where functions of numpy are called: it stays in the cache.
MEMORY_NUMBERS = 65_536
# Points evaluated at a time there, at most.
MAX_CHUNK = 16_384


@dataclass(frozen=True)
class _Call:
    """A function of numpy: the row that it writes, and its operands, which are rows or numbers."""

    function: Callable[..., Any]
    target: int
    operands: tuple[int | float, ...]


class Routine:
    """Evaluates the components of one jet: the value of an expression and its derivatives."""

    def __init__(self, components: Callable[[Traced, Traced], Sequence[Component]]) -> None:
        """``components`` gives the components from the coordinates x and y, as it would from arrays."""
        trace = Trace()
        wanted = components(Traced(trace, arithmetic.X), Traced(trace, arithmetic.Y))
        rows = [part.row for part in wanted if isinstance(part, Traced)]
        lines, sources, self._rows = compact(trace.needed(rows), rows)
        self._sources, found = np.array(sources, dtype=np.int64), iter(range(len(sources)))
        self._wanted = [next(found) if isinstance(part, Traced) else float(part or 0.0) for part in wanted]
        self._numbers = list[float]()
        self._parts = [part for is_call, group in groupby(lines, _is_call) for part in self._part(is_call, list(group))]
        self._by_blocks = not any(isinstance(part, _Call) for part in self._parts)
        least, most = arithmetic.BLOCK, MAX_CHUNK
        self._chunk = max(least, min(most, MEMORY_NUMBERS // self._rows // least * least))

    def evaluate(self, x: Array, y: Array) -> tuple[Array, ...]:
        """The components at flat arrays of points, in memory of their own."""
        x, y, results = _writeable(x), _writeable(y), np.empty((self._sources.size, x.size))
        width = min(x.size, arithmetic.BLOCK if self._by_blocks else self._chunk)
        memory = np.empty((self._rows + len(self._numbers), width))
        for row, number in enumerate(self._numbers, self._rows):
            memory[row, : arithmetic.BLOCK] = number
        if self._by_blocks:
            instructions = self._parts[0] if self._parts else np.empty((0, 5), dtype=np.int64)
            arithmetic.calculate(instructions, memory, self._rows, x, y, results, self._sources)
        else:
            for start in range(0, x.size, self._chunk):
                piece = slice(start, start + self._chunk)
                self._evaluate(x[piece], y[piece], results[:, piece], memory)
        return tuple(results[k] if isinstance(k, int) else np.full(x.shape, k) for k in self._wanted)

    def _evaluate(self, x: Array, y: Array, results: Array, memory: Array) -> None:
        """The components at as many points as the memory holds."""
        rows, nowhere = memory[:, : x.size], np.empty((0, 0))
        rows[arithmetic.X], rows[arithmetic.Y] = x, y
        for part in self._parts:
            if isinstance(part, _Call):
                operands = [rows[k] if isinstance(k, int) else k for k in part.operands]
                part.function(*operands, out=rows[part.target])
            else:
                arithmetic.calculate(part, memory, self._rows, x, y, nowhere, self._sources)
        for result, source in zip(results, self._sources, strict=True):
            result[:] = rows[source]

    def _part(self, is_call: bool, lines: list[Line]) -> list[Any]:
        """Calls, or one table of instructions."""
        if is_call:
            return [_Call(line.operation, line.target, line.operands) for line in lines if callable(line.operation)]
        return [np.array([self._instruction(line) for line in lines])]

    def _instruction(self, line: Line) -> tuple[int, ...]:
        """The line as a row of a table: numbers are rows of the memory there, and every line has three operands."""
        rows = [part if isinstance(part, int) else self._row_of(part) for part in line.operands]
        code = -1 if callable(line.operation) else line.operation
        return (code, line.target, *[*rows, rows[0], rows[0]][:3])

    def _row_of(self, number: float) -> int:
        self._numbers.append(number)
        return self._rows + len(self._numbers) - 1


def _is_call(line: Line) -> bool:
    return callable(line.operation)


def _writeable(points: Array) -> Array:
    """The points in memory that a compiled loop accepts: loops are compiled for arrays that may be written."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    return points if points.flags.writeable else points.copy()
