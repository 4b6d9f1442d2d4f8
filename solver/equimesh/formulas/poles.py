"""Poles of a field: points near which its slope grows without bound, and which samples miss."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from equimesh.numerics.types import Array

BLOCKS = 8  # in a direction: the search starts from the steepest sample of every block
HALF_WIDTH = 2  # points of the search pattern on each side of its middle
ROUNDING = np.finfo(np.float64).eps
MAX_HALVINGS = 40  # of the pattern, with the spare ones: from the spacing of the samples to about 1e-14
SPARE_HALVINGS = 5  # binary digits that a domain away from the origin may lose without fewer halvings
TRIAL_HALVINGS = 12  # after these halvings the slope near a pole grows, even if a sample lies close to it
MIN_GROWTH = 2.0**0.25  # of the slope in a halving: 2^(1 - alpha) for r^alpha, 1 for a resolved function


Evaluate: TypeAlias = Callable[[Array, Array, int], tuple[Array, ...]]
"""The value at points (x, y), and the partial derivatives up to an order."""
Map: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""The points (x, y) of points (s, t) of the unit square."""
Box: TypeAlias = tuple[tuple[float, float], tuple[float, float]]


def _identity(s: Array, t: Array) -> tuple[Array, Array]:
    return s, t


@dataclass(frozen=True, kw_only=True)
class Pole:
    """A point near which ``slope``, the largest partial derivative, still grows at the finest resolution.

    ``slope`` is infinite where the field is not finite at the point itself.
    """

    x: float
    y: float
    slope: float


def find_pole(evaluate: Evaluate, n: int, *, map: Map = _identity, box: Box = ((0.0, 1.0), (0.0, 1.0))) -> Pole | None:
    """A pole of a function; None where the search from ``n`` x ``n`` samples finds none.

    The function is searched on the closed image of the unit square under ``map``, which lies in ``box``.
    The search moves from the steepest samples to steeper points near by, on finer and finer patterns. The slope of a
    front stops growing when the front is resolved; that of a pole does not. A pole in a flat neighbourhood may be
    missed. A sample is a pole if u would change by more than its range within the rounding of a coordinate.
    """
    s, t, height = _steepest(evaluate, n, map)
    offsets = np.linspace(-1.0, 1.0, 2 * HALF_WIDTH + 1)
    size = max(abs(end) for ends in box for end in ends)
    history = [_slope(evaluate, *map(s, t))]
    steepest = int(history[0].argmax())
    if history[0][steepest] * ROUNDING * size > height > 0:
        return _pole(map, s[steepest], t[steepest], history[0][steepest])
    radius = 1.0 / (n - 1)
    for level in range(1, _levels(box, size) + 1):
        ds, dt = np.meshgrid(radius * offsets, radius * offsets, indexing="ij")
        near_s = np.clip(s[:, None] + ds.ravel(), 0.0, 1.0)
        near_t = np.clip(t[:, None] + dt.ravel(), 0.0, 1.0)
        slopes = _slope(evaluate, *map(near_s, near_t))
        best = (np.arange(s.size), slopes.argmax(axis=1))
        s, t = near_s[best], near_t[best]
        history.append(slopes[best])
        if np.isinf(history[-1]).any():
            break
        if level >= TRIAL_HALVINGS:
            grows = history[-1] > history[-1 - TRIAL_HALVINGS] * MIN_GROWTH**TRIAL_HALVINGS
            s, t, history = s[grows], t[grows], [values[grows] for values in history]
            if not s.size:
                return None
        radius /= 2
    worst = int(history[-1].argmax())
    return _pole(map, s[worst], t[worst], history[-1][worst])


def _pole(map: Map, s: Array, t: Array, slope: float) -> Pole:
    x, y = map(s, t)
    return Pole(x=float(x), y=float(y), slope=float(slope))


def _levels(box: Box, size: float) -> int:
    """The halvings after which neighbours in the pattern still differ in coordinates of this ``size``."""
    extent = min(high - low for low, high in box)
    return max(TRIAL_HALVINGS, MAX_HALVINGS - max(0, math.ceil(math.log2(size / extent)) - SPARE_HALVINGS))


def _steepest(evaluate: Evaluate, n: int, map: Map) -> tuple[Array, Array, float]:
    """The steepest sample of every block in the reference square, and the range of u over all samples."""
    axis = np.linspace(0.0, 1.0, n)
    x, y = map(*np.meshgrid(axis, axis, indexing="ij"))
    slopes, (u,) = _slope(evaluate, x, y), evaluate(x, y, 0)
    chosen = []
    for columns in np.array_split(np.arange(n), min(BLOCKS, n)):
        for rows in np.array_split(np.arange(n), min(BLOCKS, n)):
            block = np.ix_(columns, rows)
            i, j = np.unravel_index(int(slopes[block].argmax()), (columns.size, rows.size))
            chosen.append((axis[columns[i]], axis[rows[j]]))
    places = np.array(chosen)
    return places[:, 0], places[:, 1], float(np.ptp(u))


def _slope(evaluate: Evaluate, x: Array, y: Array) -> Array:
    """The largest partial derivative at points, infinite where something is not finite."""
    parts = evaluate(x, y, 1)
    slope = np.maximum(np.abs(parts[1]), np.abs(parts[2]))
    return np.where(np.isfinite(parts[0]) & np.isfinite(slope), slope, np.inf)
