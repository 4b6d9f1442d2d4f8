"""One axis of a bicubic spline: its pieces, and the cubic B-splines on them."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array, IntArray

ORDER = 4  # B-splines that are not zero on a piece of an axis, and coefficients of a cubic
BUCKETS_PER_PIECE = 8  # so that a point of an even axis seldom lies on the second piece of its bucket
MAX_CACHED_KNOTS = 2100  # knots of the longest axis whose B-splines are kept for the next samples


class Axis(NamedTuple):
    """The pieces of one axis, between ``breaks`` of shape ``(n + 1,)``, and the cubic B-splines on them.

    ``cubics[i, j, k]``, of shape ``(n, 4, 4)``, is the coefficient of ``(t - breaks[i])**k`` of the j-th B-spline that
    is not zero on piece i. ``first[b]`` is the piece where the b-th of equally wide buckets begins.
    """

    breaks: Array
    cubics: Array
    first: IntArray

    @classmethod
    def between(cls, knots: Array) -> Axis:
        """The pieces between the ``knots`` of cubic B-splines, of which the first and the last come four times."""
        if len(knots) > MAX_CACHED_KNOTS:
            return cls.of(knots)
        return _between(np.ascontiguousarray(knots, dtype=float).tobytes())

    @classmethod
    def of(cls, knots: Array) -> Axis:
        """The same, without the cache."""
        breaks = np.ascontiguousarray(knots[ORDER - 1 : len(knots) - ORDER + 1])
        starts = np.linspace(breaks[0], breaks[-1], BUCKETS_PER_PIECE * (len(breaks) - 1) + 1)
        first = np.clip(np.searchsorted(breaks, starts, side="right") - 1, 0, len(breaks) - 2)
        return cls(breaks, _cubics(knots), first.astype(np.int64))

    def inside(self, t: Array) -> Array:
        """The points of the axis nearest to ``t``."""
        return np.clip(t, self.breaks[0], self.breaks[-1])


@lru_cache(maxsize=64)
def _between(knots: bytes) -> Axis:
    """The pieces of an axis, cached: the samples of all time steps have the same axes."""
    return Axis.of(np.frombuffer(knots))


def _cubics(knots: Array) -> Array:
    """The B-splines on every piece by the recursion of Cox and de Boor, on coefficients instead of values."""
    piece = np.arange(ORDER - 1, len(knots) - ORDER)
    start = knots[piece]
    splines = [np.zeros((len(piece), ORDER)) for _ in range(ORDER)]
    splines[-1][:, 0] = 1.0
    for degree in range(1, ORDER):
        raised = [np.zeros((len(piece), ORDER)) for _ in range(ORDER)]
        for j in range(ORDER - 1 - degree, ORDER):
            left = piece - (ORDER - 1) + j
            if j >= ORDER - degree:
                low, high = knots[left], knots[left + degree]
                raised[j] += _times_line(splines[j], (start - low) / (high - low), 1.0 / (high - low))
            if j + 1 < ORDER:
                low, high = knots[left + 1], knots[left + degree + 1]
                raised[j] += _times_line(splines[j + 1], (high - start) / (high - low), -1.0 / (high - low))
        splines = raised
    return np.stack(splines, axis=1)


def _times_line(cubics: Array, constant: Array, slope: Array) -> Array:
    """Polynomials, a row of coefficients each, times ``constant + slope * t``."""
    product = constant[:, None] * cubics
    product[:, 1:] += slope[:, None] * cubics[:, :-1]
    return product


@vectorised
def buckets_per_length(axis: Axis) -> float:
    """The ``scale`` of :func:`piece`."""
    return float((axis.first.size - 1) / (axis.breaks[-1] - axis.breaks[0]))


@vectorised
def piece(t: float, axis: Axis, scale: float) -> int:
    """The number of the piece that the point ``t`` lies on: the last one that begins at or before it."""
    breaks, first = axis.breaks, axis.first
    bucket = min(int((t - breaks[0]) * scale), first.size - 2)
    low, high = first[bucket], min(first[bucket + 1] + 1, breaks.size - 2)
    if breaks[low] <= t < breaks[low + 1]:  # almost always
        return int(low)
    while low > 0 and t < breaks[low]:  # at the edge of a bucket rounding may miss the piece
        low -= 1
    while low < high:
        middle = (low + high + 1) // 2
        if breaks[middle] <= t:
            low = middle
        else:
            high = middle - 1
    return int(low)


@vectorised
def at_piece(cubics: Array, j: int, t: float) -> tuple[float, float, float, float]:
    """The four B-splines of piece ``j``, ``t`` beyond its begin."""
    return (
        cubics[j, 0, 0] + t * (cubics[j, 0, 1] + t * (cubics[j, 0, 2] + t * cubics[j, 0, 3])),
        cubics[j, 1, 0] + t * (cubics[j, 1, 1] + t * (cubics[j, 1, 2] + t * cubics[j, 1, 3])),
        cubics[j, 2, 0] + t * (cubics[j, 2, 1] + t * (cubics[j, 2, 2] + t * cubics[j, 2, 3])),
        cubics[j, 3, 0] + t * (cubics[j, 3, 1] + t * (cubics[j, 3, 2] + t * cubics[j, 3, 3])),
    )


@vectorised
def slopes_at_piece(cubics: Array, j: int, t: float) -> tuple[float, float, float, float]:
    """Their derivatives."""
    return (
        cubics[j, 0, 1] + t * (2.0 * cubics[j, 0, 2] + t * 3.0 * cubics[j, 0, 3]),
        cubics[j, 1, 1] + t * (2.0 * cubics[j, 1, 2] + t * 3.0 * cubics[j, 1, 3]),
        cubics[j, 2, 1] + t * (2.0 * cubics[j, 2, 2] + t * 3.0 * cubics[j, 2, 3]),
        cubics[j, 3, 1] + t * (2.0 * cubics[j, 3, 2] + t * 3.0 * cubics[j, 3, 3]),
    )
