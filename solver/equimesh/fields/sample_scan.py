"""What has to be known of all samples in a file, from one pass over it in blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

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


def scan(values: SampleArray, x: Array, y: Array) -> Scan:
    """Read all samples once.

    Raises :class:`~equimesh.errors.SamplesError` for one that is not finite or too large, by its index in the whole
    array, and for a slope between two that is too large.
    """
    low, high, steps = np.inf, -np.inf, [Step(size=-1.0, i=0, j=0)] * 2
    above: dict[int, Array] = {}
    for rows, row_blocks in _by_rows(values):
        left = np.empty((rows.stop - rows.start, 0))
        for columns in row_blocks:
            block = values.read(rows, columns)
            _check(block, rows.start, columns.start)
            low, high = min(low, float(block.min())), max(high, float(block.max()))
            before = above.get(columns.start, block[:0])
            along_x, along_y = np.concatenate([before, block]), np.concatenate([left, block], axis=1)
            first = rows.start - len(before), columns.start - left.shape[1]
            steps[0] = _larger(steps[0], along_x, 0, (first[0], columns.start))
            steps[1] = _larger(steps[1], along_y, 1, (rows.start, first[1]))
            _check_slopes(along_x, 0, x, first[0])
            _check_slopes(along_y, 1, y, first[1])
            above[columns.start], left = block[-1:].copy(), block[:, -1:].copy()
    return Scan(low=low, high=high, steps=(steps[0], steps[1]))


def steps_of(values: Array) -> tuple[float, tuple[Step, Step]]:
    """The range of samples in memory, and the largest step along x and along y."""
    nothing = Step(size=-1.0, i=0, j=0)
    along_x, along_y = (_larger(nothing, values, axis, (0, 0)) for axis in (0, 1))
    return float(np.ptp(values)), (along_x, along_y)


def _by_rows(values: SampleArray) -> Iterator[tuple[slice, list[slice]]]:
    """Blocks of whole chunks: rows, and the columns of the blocks in these rows."""
    (n, m), (height, width) = values.shape, (min(a, b) for a, b in zip(values.chunk, values.shape, strict=True))
    width = width * max(1, min(-(-m // width), MAX_BLOCK_NUMBERS // (height * width)))
    height = height * max(1, MAX_BLOCK_NUMBERS // (height * width))
    for row in range(0, n, height):
        columns = [slice(column, min(column + width, m)) for column in range(0, m, width)]
        yield slice(row, min(row + height, n)), columns


def _check(block: Array, row: int, column: int) -> None:
    bad = ~(np.abs(block) <= LIMITS.magnitude)
    if not bad.any():
        return
    a, b = (int(k) for k in np.unravel_index(int(bad.argmax()), bad.shape))
    value = block[a, b]
    if not np.isfinite(value):
        raise not_finite(value, a + row, b + column)
    raise SamplesError(
        f"values[{a + row}][{b + column}] = {value:.6g}: at most {LIMITS.magnitude:g} in size is allowed; rescale u",
        field="values",
    )


def _larger(step: Step, block: Array, axis: int, first: tuple[int, int]) -> Step:
    """The larger of ``step`` and those of a block, whose first sample has the index ``first``."""
    if block.shape[axis] < 2:
        return step
    sizes = np.abs(np.diff(block, axis=axis))
    a, b = (int(k) for k in np.unravel_index(int(sizes.argmax()), sizes.shape))
    if sizes[a, b] <= step.size:
        return step
    return Step(size=float(sizes[a, b]), i=a + first[0], j=b + first[1])


def _check_slopes(block: Array, axis: int, points: Array, first: int) -> None:
    """Refuse neighbours with too large a slope between them."""
    lengths = np.diff(points[first : first + block.shape[axis]])
    if not lengths.size:
        return
    with np.errstate(over="ignore"):
        steepest = float(np.abs(np.diff(block, axis=axis)).max() / lengths.min())
    if steepest > LIMITS.magnitude:
        raise slope_error(points, "xy"[axis])
