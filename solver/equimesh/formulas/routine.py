"""Routines: formulas at many points, as one compiled loop over a list of instructions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from equimesh.formulas.jet import Component
from equimesh.numerics.calls import loop_of, numpy_loop
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

# The interpreter is called once for all instructions, not once for each of them. So threads that evaluate expressions
# at the same time do not wait for each other, and an expression at few points takes microseconds. Sine, tanh and others
# are the loops of NumPy, which are called by their addresses. The results are those of NumPy, to the last bit.

# Numbers worked on at a time: the operands of all instructions stay in the cache.
BLOCK = 512
# Between the rows: where one ends at the next, NumPy 1.26 takes them for one and runs loops with other last digits.
GAP = 8

ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE, ABSOLUTE, SQRT, CALL = range(8)
"""Instructions with numbers; the last one runs a loop of NumPy."""
LESS, LESS_EQUAL, GREATER, GREATER_EQUAL, EQUAL, NOT_EQUAL, AND, OR, NOT, WHERE = range(8, 18)
"""Instructions with conditions, which are the numbers 1 and 0."""

X, Y, FIRST_FREE = range(3)
"""Rows of the memory: the coordinates, and the first one for what is computed."""


class Table(NamedTuple):
    """The ``instructions`` of a formula, with memory for one block of points.

    An instruction has a code, the row of the ``memory`` that it writes, and three rows that it reads, which are others.
    The rows of the memory from ``numbers`` on hold one number each. The last operand of a call is the row of ``loops``
    with the address of the loop, what that is given, and how many rows it reads. The c-th result is the memory's row
    ``results[c]``.
    """

    instructions: IntArray
    loops: IntArray
    memory: Array
    numbers: int
    results: IntArray


@compiled
def calculate(table: Table, x: Array, y: Array, rows: Array) -> None:
    """Do all instructions at all points ``x``, ``y``; the results begin the ``rows``."""
    instructions, loops, memory, numbers, results = table
    places, count, strides = np.empty(3, np.int64), np.empty(1, np.int64), np.empty(3, np.int64)
    for start in range(0, x.size, BLOCK):
        size = min(BLOCK, x.size - start)
        for j in range(size):  # assigned slices take the compiler seconds, for the words of an error
            memory[X, j] = x[start + j]
            memory[Y, j] = y[start + j]
        count[0] = size
        for k in range(instructions.shape[0]):
            code = instructions[k, 0]
            target = memory[instructions[k, 1], :size]
            one, two = memory[instructions[k, 2], :size], memory[instructions[k, 3], :size]
            if code == CALL:
                called = instructions[k, 4]
                inputs = loops[called, 2]
                for part in range(2):
                    # A number is one for all points, as in a call of NumPy: some powers have loops of their own.
                    row = instructions[k, 2 + part]
                    places[part], strides[part] = memory[row].ctypes.data, 8 if row < numbers else 0
                places[inputs], strides[inputs] = target.ctypes.data, 8
                numpy_loop(
                    loops[called, 0], places.ctypes.data, count.ctypes.data, strides.ctypes.data, loops[called, 1]
                )
            elif code == WHERE:
                choose(target, one, two, memory[instructions[k, 4], :size])
            elif code >= LESS:
                decide(code, target, one, two)
            elif code == ADD:
                for j in range(size):
                    target[j] = one[j] + two[j]
            elif code == SUBTRACT:
                for j in range(size):
                    target[j] = one[j] - two[j]
            elif code == MULTIPLY:
                for j in range(size):
                    target[j] = one[j] * two[j]
            elif code == DIVIDE:
                for j in range(size):
                    target[j] = one[j] / two[j]
            elif code == NEGATE:
                for j in range(size):
                    target[j] = -one[j]
            elif code == ABSOLUTE:
                for j in range(size):
                    target[j] = abs(one[j])
            else:
                for j in range(size):
                    target[j] = np.sqrt(one[j])
        for c in range(results.size):
            for j in range(size):
                rows[c, start + j] = memory[results[c], j]


@compiled
def choose(target: Array, condition: Array, one: Array, two: Array) -> None:
    """``one`` where the condition holds, else ``two``."""
    for j in range(target.size):
        target[j] = one[j] if condition[j] != 0.0 else two[j]


@compiled
def decide(code: int, target: Array, one: Array, two: Array) -> None:
    """One comparison, or a connection of conditions."""
    size = target.size
    if code == LESS:
        for j in range(size):
            target[j] = 1.0 if one[j] < two[j] else 0.0
    elif code == LESS_EQUAL:
        for j in range(size):
            target[j] = 1.0 if one[j] <= two[j] else 0.0
    elif code == GREATER:
        for j in range(size):
            target[j] = 1.0 if one[j] > two[j] else 0.0
    elif code == GREATER_EQUAL:
        for j in range(size):
            target[j] = 1.0 if one[j] >= two[j] else 0.0
    elif code == EQUAL:
        for j in range(size):
            target[j] = 1.0 if one[j] == two[j] else 0.0
    elif code == NOT_EQUAL:
        for j in range(size):
            target[j] = 1.0 if one[j] != two[j] else 0.0
    elif code == AND:
        for j in range(size):
            target[j] = one[j] * two[j]
    elif code == OR:
        for j in range(size):
            target[j] = max(one[j], two[j])
    else:
        for j in range(size):
            target[j] = 1.0 - one[j]


# The arithmetic of an expression, written down while it is done with numbers that are not known yet.
#
# The rules for derivatives are written once, for arrays. A :class:`TracedRow` takes the place of an array: each
# operation on it gives another one, and adds a line to the list of all operations.

CODES: Mapping[Callable[..., Any], int] = MappingProxyType(
    {
        np.add: ADD,
        np.subtract: SUBTRACT,
        np.multiply: MULTIPLY,
        np.divide: DIVIDE,
        np.negative: NEGATE,
        np.absolute: ABSOLUTE,
        np.sqrt: SQRT,
        np.less: LESS,
        np.less_equal: LESS_EQUAL,
        np.greater: GREATER,
        np.greater_equal: GREATER_EQUAL,
        np.equal: EQUAL,
        np.not_equal: NOT_EQUAL,
        np.logical_and: AND,
        np.bitwise_and: AND,
        np.logical_or: OR,
        np.logical_not: NOT,
        np.where: WHERE,
    }
)
"""The operations that are instructions; all others are loops of NumPy."""


@dataclass(frozen=True)
class Line:
    """An operation: the code of an instruction or a function of numpy, the row that it writes, and its operands.

    Operands are rows, or numbers.
    """

    operation: int | np.ufunc
    target: int
    operands: tuple[int | float, ...]


@dataclass(eq=False)
class Trace:
    """The operations in their order. Each writes a row of its own, from ``FIRST_FREE`` on."""

    lines: list[Line] = field(default_factory=list)

    def add(self, function: Any, operands: Sequence[Any]) -> TracedRow:
        """One more operation."""
        known = tuple(part.row if isinstance(part, TracedRow) else float(part) for part in operands)
        self.lines.append(Line(CODES.get(function, function), FIRST_FREE + len(self.lines), known))
        return TracedRow(self, self.lines[-1].target)

    def needed(self, results: Iterable[int]) -> list[Line]:
        """The lines on which the rows ``results`` depend."""
        rows, found = set(results), list[Line]()
        for line in reversed(self.lines):
            if line.target in rows:
                found.append(line)
                rows.update(part for part in line.operands if isinstance(part, int))
        return found[::-1]


class TracedRow(NDArrayOperatorsMixin):
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
    rows, free, count = {X: X, Y: Y}, list[int](), FIRST_FREE
    found = []
    for number, line in enumerate(lines):
        if not free:
            free.append(count)
            count += 1
        rows[line.target] = free.pop()
        operands = tuple(rows[part] if isinstance(part, int) else part for part in line.operands)
        found.append(Line(line.operation, rows[line.target], operands))
        for part in {part for part in line.operands if isinstance(part, int)}:
            if last[part] == number and part >= FIRST_FREE and part not in results:
                free.append(rows[part])
    return found, [rows[row] for row in results], count


class Routine:
    """Evaluates the components of one jet: the value of an expression and its derivatives."""

    def __init__(self, components: Callable[[TracedRow, TracedRow], Sequence[Component]]) -> None:
        """``components`` gives the components from the coordinates x and y, as it would from arrays."""
        trace = Trace()
        wanted = components(TracedRow(trace, X), TracedRow(trace, Y))
        rows = [part.row for part in wanted if isinstance(part, TracedRow)]
        lines, sources, self._rows = compact(trace.needed(rows), rows)
        self._numbers, self._loops = list[float](), list[tuple[int, int, int]]()
        instructions = [self._instruction(line) for line in lines]
        found = iter(sources)
        results = [next(found) if isinstance(part, TracedRow) else self._row_of(float(part or 0.0)) for part in wanted]
        self._results = np.array(results, dtype=np.int64)
        self._instructions = np.array(instructions, dtype=np.int64).reshape(-1, 5)
        self._table = np.array(self._loops, dtype=np.int64).reshape(-1, 3)
        self._column = np.array(self._numbers).reshape(-1, 1)

    def table(self, points: int = BLOCK) -> Table:
        """The instructions with memory of their own, for so many points at once."""
        memory = np.empty((self._rows + len(self._numbers), min(points, BLOCK) + GAP))
        memory[self._rows :] = self._column
        return Table(self._instructions, self._table, memory, self._rows, self._results)

    def evaluate(self, x: Array, y: Array) -> tuple[Array, ...]:
        """The components at flat arrays of points, in memory of their own."""
        x, y, rows = _writeable(x), _writeable(y), np.empty((self._results.size, x.size))
        calculate(self.table(x.size), x, y, rows)
        return tuple(rows)

    def _instruction(self, line: Line) -> tuple[int, ...]:
        """The line as a row of a table: numbers are rows of the memory there, and every line has three operands."""
        rows = [part if isinstance(part, int) else self._row_of(part) for part in line.operands]
        one, two, three = [*rows, rows[0], rows[0]][:3]
        if isinstance(line.operation, int):
            return line.operation, line.target, one, two, three
        self._loops.append((*loop_of(line.operation), line.operation.nin))
        return CALL, line.target, one, two, len(self._loops) - 1

    def _row_of(self, number: float) -> int:
        self._numbers.append(number)
        return self._rows + len(self._numbers) - 1


def _writeable(points: Array) -> Array:
    """The points in memory that a compiled loop accepts: loops are compiled for arrays that may be written."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    return points if points.flags.writeable else points.copy()
