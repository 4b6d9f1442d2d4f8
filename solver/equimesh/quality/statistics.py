"""Extremes, mean and root mean square of numbers that come in blocks."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array


class Statistics(NamedTuple):
    """The largest and the smallest of some numbers, their mean and the root of the mean of their squares."""

    max: float
    min: float
    mean: float
    rms: float

    @classmethod
    def of(cls, parts: Array, count: int) -> Statistics:
        """Those of ``count`` numbers, from the :func:`parts` of their blocks, of shape ``(blocks, 4)``."""
        total, squares = float(parts[:, 2].sum()), float(parts[:, 3].sum())
        return cls(float(parts[:, 0].max()), float(parts[:, 1].min()), total / count, math.sqrt(squares / count))

    def times(self, factor: float) -> Statistics:
        """Those of the numbers times a positive ``factor``."""
        return Statistics(*(factor * value for value in self))


def fill_parts(rows: Array, out: Array) -> None:
    """Fill ``out``, of shape ``(rows, 4)``, with the largest and smallest, the sum and the sum of squares of each row.

    Where a number is not finite they are what numpy says.
    """
    fast_parts(rows, out)
    for row, part in zip(rows, out, strict=True):
        if not math.isfinite(part[3]):
            part[:] = row.max(), row.min(), row.sum(), np.square(row).sum()


@vectorised
def fast_parts(rows: Array, out: Array) -> None:
    """As :func:`fill_parts` where all numbers are finite; where one is not, the last number of its row is neither."""
    for r in range(rows.shape[0]):
        row = rows[r]
        high, low, total, squares = row[0], row[0], 0.0, 0.0
        for k in range(row.size):
            high, low = max(high, row[k]), min(low, row[k])
            total += row[k]
            squares += row[k] * row[k]
        out[r, 0], out[r, 1], out[r, 2], out[r, 3] = high, low, total, squares
