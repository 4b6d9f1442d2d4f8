"""Parts of curves: from which t to which an edge runs, and where its nodes stand."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from equimesh.blocks.curves import BoundaryCurve, Point
from equimesh.errors import InputError
from equimesh.numerics.types import Array

# Parts of an edge between which the length of the curve is summed.
LENGTH_PARTS = 512
# Newton steps from the table to the t of a length.
NEWTON_STEPS = 4
# Speeds that differ by less, as a share, are one speed.
SAME_SPEED = 1e-12
# Two ways around a closed curve whose lengths differ by less, as a share, are equally long.
EQUALLY_LONG = 1e-6
GAUSS = np.polynomial.legendre.leggauss(5)


def span(curve: BoundaryCurve, first: float, last: float, *, via: Point | None, name: str, field: str) -> Array:
    """The t at the begin and at the end of an edge between the places ``first`` and ``last``, shape ``(2,)``.

    On a closed curve t may leave the ends of the curve. There the edge takes the way through the point ``via``, or else
    the shorter one; an edge from a place to itself is the whole curve, with t rising. Raises
    :class:`~equimesh.errors.InputError` where both ways are equally long.
    """
    if not curve.closed:
        return np.array([first, last])
    period = curve.ends[1] - curve.ends[0]
    rise = (last - first) % period
    if min(rise, period - rise) < EQUALLY_LONG * period:
        return np.array([first, first + period])
    ways = np.array([[first, first + rise], [first, first + rise - period]])
    if via is not None:
        at = float(curve.nearest(np.array(via[0]), np.array(via[1])))
        return np.asarray(ways[0] if (at - first) % period <= rise else ways[1])
    lengths = [abs(_length_table(curve, *way)[1][-1]) for way in ways]
    if abs(lengths[0] - lengths[1]) < EQUALLY_LONG * sum(lengths):
        middle = [float(part) for part in curve.evaluate(np.array(ways[0].mean()))[:2]]
        raise InputError(
            f"the edge {name} can take two ways around its curve, and both are equally long: name a point of the way"
            f' with "via", such as [{middle[0]:.6g}, {middle[1]:.6g}]',
            field=field,
        )
    return np.asarray(ways[int(np.argmin(lengths))])


def parameters_at(curve: BoundaryCurve, ends: Array, shares: Array) -> Array:
    """The t at which an edge between the two ``ends`` has these shares of its length; the ends are met exactly."""
    t, length, speed = _length_table(curve, *ends)
    even = ends[0] + (ends[1] - ends[0]) * shares
    if np.ptp(speed) <= SAME_SPEED * speed.max():
        found = even
    else:
        goal = length[-1] * shares
        found = np.interp(goal, length, t) if length[-1] > 0 else even
        table = CubicHermiteSpline(t, length, speed) if t[1] > t[0] else CubicHermiteSpline(-t, length, speed)
        sign = 1.0 if t[1] > t[0] else -1.0
        slope = table.derivative()
        for _ in range(NEWTON_STEPS):
            ahead = (goal - table(sign * found)) / np.maximum(slope(sign * found), 0.1 * speed.mean() / LENGTH_PARTS)
            found = np.clip(found + sign * ahead, min(ends), max(ends))
    found[0], found[-1] = ends
    return np.asarray(found)


def _length_table(curve: BoundaryCurve, first: float, last: float) -> tuple[Array, Array, Array]:
    """Values of t from first to last, the length of the curve up to each of them, and its speed there."""
    t = np.linspace(first, last, LENGTH_PARTS + 1)
    half, middle = 0.5 * np.diff(t), 0.5 * (t[1:] + t[:-1])
    speeds = np.hypot(*curve.evaluate(middle[:, None] + half[:, None] * GAUSS[0])[2:])
    parts = np.abs(half) * (speeds * GAUSS[1]).sum(axis=1)
    return t, np.concatenate([[0.0], np.cumsum(parts)]), np.hypot(*curve.evaluate(t)[2:])
