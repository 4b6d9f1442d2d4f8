"""Range, faults, noise and jumps of all samples in a file, from one pass over it in blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from equimesh.errors import SamplesError
from equimesh.fields.samples import slope_error
from equimesh.fields.tiles import not_finite
from equimesh.formulas.vocabulary import LIMITS
from equimesh.io.sample_arrays import SampleArray
from equimesh.numerics.types import Array

# Numbers of the largest block that is read at a time, unless one chunk has more.
MAX_BLOCK_NUMBERS = 1 << 22


@dataclass(frozen=True, kw_only=True)
class Step:
    """The largest difference of two neighbours along one axis: its ``size``, and the index of the first of the two."""

    size: float
    i: int
    j: int


@dataclass(frozen=True, kw_only=True)
class Scan:
    """The smallest and the largest sample, and the largest step along x and along y."""

    low: float
    high: float
    steps: tuple[Step, Step]

    @property
    def size(self) -> float:
        """The range of the samples."""
        return self.high - self.low


# The step of one sample, which has no neighbours.
NOTHING = Step(size=-1.0, i=0, j=0)


def scan(values: SampleArray, x: Array, y: Array) -> Scan:
    """Read all samples once.

    Raises :class:`~equimesh.errors.SamplesError` for one that is not finite or too large, by its index in the whole
    array, and for a slope between two that is too large.
    """
    low, high, steps = np.inf, -np.inf, [NOTHING, NOTHING]
    above: dict[int, Array] = {}
    for rows, row_blocks in _by_rows(values):
        left: Array | None = None
        for columns in row_blocks:
            block = values.read(rows, columns)
            lowest, highest = float(block.min()), float(block.max())
            if not max(-lowest, highest) <= LIMITS.magnitude:  # NaN, too
                _refuse(block, rows.start, columns.start)
            low, high = min(low, lowest), max(high, highest)
            row, column = rows.start, columns.start
            pieces = [(0, block, row, column), (1, block, row, column)]
            if column in above:
                pieces.append((0, np.concatenate([above[column], block[:1]]), row - 1, column))
            if left is not None:
                pieces.append((1, np.concatenate([left, block[:, :1]], axis=1), row, column - 1))
            for axis, piece, i, j in pieces:
                found = _largest_step(piece, axis, (i, j))
                _check_slope(found, piece.shape[axis], (x, y)[axis], (i, j)[axis], "xy"[axis])
                steps[axis] = max(steps[axis], found, key=lambda step: step.size)
            above[column], left = block[-1:].copy(), block[:, -1:].copy()
    return Scan(low=low, high=high, steps=(steps[0], steps[1]))


def steps_of(values: Array) -> tuple[float, tuple[Step, Step]]:
    """The range of samples in memory, and the largest step along x and along y."""
    along_x, along_y = (_largest_step(values, axis, (0, 0)) for axis in (0, 1))
    return float(np.ptp(values)), (along_x, along_y)


def _by_rows(values: SampleArray) -> Iterator[tuple[slice, list[slice]]]:
    """Blocks of whole chunks: rows, and the columns of the blocks in these rows."""
    (n, m), (height, width) = values.shape, (min(a, b) for a, b in zip(values.chunk, values.shape, strict=True))
    width = width * max(1, min(-(-m // width), MAX_BLOCK_NUMBERS // (height * width)))
    height = height * max(1, MAX_BLOCK_NUMBERS // (height * width))
    for row in range(0, n, height):
        columns = [slice(column, min(column + width, m)) for column in range(0, m, width)]
        yield slice(row, min(row + height, n)), columns


def _refuse(block: Array, row: int, column: int) -> NoReturn:
    """Raise the error for the first sample of a block that is not finite or too large."""
    bad = ~(np.abs(block) <= LIMITS.magnitude)
    a, b = (int(k) for k in np.unravel_index(int(bad.argmax()), bad.shape))
    value = block[a, b]
    if not np.isfinite(value):
        raise not_finite(value, a + row, b + column)
    raise SamplesError(
        f"values[{a + row}][{b + column}] = {value:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale u",
        field="values",
    )


def _largest_step(block: Array, axis: int, first: tuple[int, int]) -> Step:
    """The largest step of a block, whose first sample has the index ``first``."""
    if block.shape[axis] < 2:
        return NOTHING
    sizes = np.diff(block, axis=axis)
    np.abs(sizes, out=sizes)
    a, b = (int(k) for k in np.unravel_index(int(sizes.argmax()), sizes.shape))
    return Step(size=float(sizes[a, b]), i=a + first[0], j=b + first[1])


def _check_slope(step: Step, count: int, points: Array, first: int, name: str) -> None:
    """Refuse a step of neighbours that is too large for the smallest distance of these points."""
    lengths = np.diff(points[first : first + count])
    if lengths.size and step.size > LIMITS.magnitude * float(lengths.min()):
        raise slope_error(points, name)
