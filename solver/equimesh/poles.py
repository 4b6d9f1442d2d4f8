"""Poles of a field: points of the unit square that no sample hits, and near which its slope grows without bound."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from equimesh.field import Field

Array: TypeAlias = npt.NDArray[np.float64]

BLOCKS = 8  # a direction: each block of sample points sends the search after its own steepest point
HALF_WIDTH = 2  # points of the search pattern on each side of its middle
ROUNDING = np.finfo(np.float64).eps
LEVELS = 40  # halvings of the pattern: from the spacing of the samples to about 1e-14
TRIAL = 12  # the first halvings, in which a pole may lie too near to a sample to show
GROWTH = 2.0**0.25  # of the slope in a halving; r^alpha grows by 2^(1 - alpha), what is resolved by 1


@dataclass(frozen=True, kw_only=True)
class Pole:
    """A point near which ``slope``, the largest partial derivative, still grows at the finest resolution.

    ``slope`` is infinite where the field is not finite at the very point.
    """

    x: float
    y: float
    slope: float


def find_pole(field: Field, n: int) -> Pole | None:
    """A pole of the field in the unit square; None where the search from ``n`` x ``n`` samples finds none.

    The search climbs from the steepest samples to steeper points near by, on finer and finer patterns. A front is
    climbed until it is resolved, a pole never is. It may miss a pole whose neighbourhood is as flat as the rest.
    A sample where u would change by more than its range within the rounding of a coordinate sits on a pole itself.
    """
    x, y, height = _steepest(field, n)
    offsets = np.linspace(-1.0, 1.0, 2 * HALF_WIDTH + 1)
    history = [_slope(field, x, y)]
    steepest = int(history[0].argmax())
    if history[0][steepest] * ROUNDING > height > 0:
        return Pole(x=float(x[steepest]), y=float(y[steepest]), slope=float(history[0][steepest]))
    radius = 1.0 / (n - 1)
    for level in range(1, LEVELS + 1):
        dx, dy = np.meshgrid(radius * offsets, radius * offsets, indexing="ij")
        xs = np.clip(x[:, None] + dx.ravel(), 0.0, 1.0)
        ys = np.clip(y[:, None] + dy.ravel(), 0.0, 1.0)
        slopes = _slope(field, xs, ys)
        best = (np.arange(x.size), slopes.argmax(axis=1))
        x, y = xs[best], ys[best]
        history.append(slopes[best])
        if np.isinf(history[-1]).any():
            break
        if level >= TRIAL:
            grows = history[-1] > history[-1 - TRIAL] * GROWTH**TRIAL
            x, y, history = x[grows], y[grows], [values[grows] for values in history]
            if not x.size:
                return None
        radius /= 2
    worst = int(history[-1].argmax())
    return Pole(x=float(x[worst]), y=float(y[worst]), slope=float(history[-1][worst]))


def _steepest(field: Field, n: int) -> tuple[Array, Array, float]:
    """The steepest sample of every block of samples, and the range of u over all of them."""
    axis = np.linspace(0.0, 1.0, n)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    slopes, (u,) = _slope(field, x, y), field.evaluate(x, y)
    chosen = []
    for columns in np.array_split(np.arange(n), min(BLOCKS, n)):
        for rows in np.array_split(np.arange(n), min(BLOCKS, n)):
            block = np.ix_(columns, rows)
            i, j = np.unravel_index(int(slopes[block].argmax()), (columns.size, rows.size))
            chosen.append((axis[columns[i]], axis[rows[j]]))
    places = np.array(chosen)
    return places[:, 0], places[:, 1], float(np.ptp(u))


def _slope(field: Field, x: Array, y: Array) -> Array:
    """The largest partial derivative at points, infinite where something is not finite."""
    parts = field.evaluate(x, y, order=1)
    slope = np.maximum(np.abs(parts[1]), np.abs(parts[2]))
    return np.where(np.isfinite(parts[0]) & np.isfinite(slope), slope, np.inf)
