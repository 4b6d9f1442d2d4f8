"""Arithmetic on many numbers at once, as one compiled loop over a list of instructions.

The interpreter is called once for all instructions, not once for each of them. So threads that evaluate expressions at
the same time do not wait for each other, and an expression at few points takes microseconds. The results are those of
numpy, to the last bit.
"""

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

# Numbers worked on at a time: the operands of all instructions stay in the first cache.
BLOCK = 512

ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE, ABSOLUTE, SQRT, COPY = range(8)
"""Instructions with numbers."""
LESS, LESS_EQUAL, GREATER, GREATER_EQUAL, EQUAL, NOT_EQUAL, AND, OR, NOT, WHERE = range(8, 18)
"""Instructions with conditions, which are the numbers 1 and 0."""

X, Y, FIRST_FREE = range(3)
"""Rows of the memory: the coordinates, and the first one for what is computed."""


@compiled
def calculate(
    instructions: IntArray, memory: Array, numbers: int, x: Array, y: Array, results: Array, sources: IntArray
) -> None:
    """Do all ``instructions`` at all points ``x``, ``y``.

    An instruction has a code, the row of the ``memory`` that it writes, and three rows that it reads, which are others.
    The rows from ``numbers`` on hold one number each, in their first ``BLOCK`` places. Where there are ``results``, the
    rows hold one block of points at a time: the coordinates are read into it, and the row ``sources[c]`` becomes a part
    of ``results[c]``. Without ``results`` the rows hold all points.
    """
    for start in range(0, x.size, BLOCK):
        size, shift = min(BLOCK, x.size - start), start
        if results.shape[0] > 0:
            shift = 0
            memory[X, :size] = x[start : start + size]
            memory[Y, :size] = y[start : start + size]
        for k in range(instructions.shape[0]):
            code = instructions[k, 0]
            target = memory[instructions[k, 1], shift : shift + size]
            begin = shift if instructions[k, 2] < numbers else 0
            one = memory[instructions[k, 2], begin : begin + size]
            begin = shift if instructions[k, 3] < numbers else 0
            two = memory[instructions[k, 3], begin : begin + size]
            if code == WHERE:
                begin = shift if instructions[k, 4] < numbers else 0
                choose(target, one, two, memory[instructions[k, 4], begin : begin + size])
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
            elif code == SQRT:
                for j in range(size):
                    target[j] = np.sqrt(one[j])
            else:
                for j in range(size):
                    target[j] = one[j]
        for c in range(results.shape[0]):
            results[c, start : start + size] = memory[sources[c], :size]


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
