"""Boundary curves on which nodes slide: straight lines, circles, and curves that formulas give."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, TypeAlias

import numpy as np
import scipy

from equimesh.domains.curve import Curve
from equimesh.domains.domain import PLACES, areas_between, changes_of_areas
from equimesh.errors import InputError
from equimesh.numerics.types import Array, BoolArray, IntArray

Point: TypeAlias = tuple[float, float]

# Places on a curve at which the search for the nearest point begins.
SEARCH_POINTS = 1025
# Steps of the search; each one halves the distance at least.
SEARCH_STEPS = 40
# The largest distance between begin and end of a closed formula, as a share of its speed.
MAX_GAP_SHARE = 1e-9
# The largest angle, in radians, between begin and end of a closed formula that has no corner there.
MAX_BEND = 1e-6


class BoundaryCurve(Protocol):
    """A curve ``(x(t), y(t))`` with a parameter t between two ends; nodes that slide on it have t as their unknown.

    ``box``, ``area`` and nodes of the finished mesh follow from it, so ``evaluate`` must be exact to rounding.
    """

    @property
    def ends(self) -> tuple[float, float]:
        """The smallest and the largest t."""
        ...

    @property
    def closed(self) -> bool:
        """Whether the curve ends where it begins. Any t is then allowed, and repeats after ``ends[1] - ends[0]``."""
        ...

    @property
    def corners(self) -> Array:
        """Values of t at which the direction jumps; a closed curve with a corner at its begin has it once."""
        ...

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` at values of t of any shape; slightly beyond the ends the curve is continued."""
        ...

    def nearest(self, x: Array, y: Array) -> Array:
        """The t of the point of the curve that is nearest to each of these points, within the ends."""
        ...


@dataclass(frozen=True, kw_only=True)
class Line:
    """The straight line from ``start`` to ``end``; t is the distance from ``start``. A :class:`BoundaryCurve`."""

    start: Point
    end: Point

    @property
    def length(self) -> float:
        """The distance of the ends."""
        return math.hypot(self.end[0] - self.start[0], self.end[1] - self.start[1])

    @property
    def direction(self) -> Point:
        """The unit vector from start to end."""
        return (self.end[0] - self.start[0]) / self.length, (self.end[1] - self.start[1]) / self.length

    @property
    def ends(self) -> tuple[float, float]:
        """0 and the length."""
        return 0.0, self.length

    @property
    def closed(self) -> bool:
        """A line is never closed."""
        return False

    @property
    def corners(self) -> Array:
        """A line has none."""
        return np.empty(0)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, as :meth:`BoundaryCurve.evaluate`."""
        (x, y), (along_x, along_y) = self.start, self.direction
        return x + along_x * t, y + along_y * t, np.full(np.shape(t), along_x), np.full(np.shape(t), along_y)

    def nearest(self, x: Array, y: Array) -> Array:
        """The foot of the perpendicular, or an end."""
        along = (x - self.start[0]) * self.direction[0] + (y - self.start[1]) * self.direction[1]
        return np.asarray(np.clip(along, 0.0, self.length))


@dataclass(frozen=True, kw_only=True)
class Circle:
    """The circle around ``center``; t is the angle in radians, counter-clockwise. A :class:`BoundaryCurve`."""

    center: Point = (0.0, 0.0)
    radius: float = 1.0

    @property
    def ends(self) -> tuple[float, float]:
        """-pi and pi."""
        return -math.pi, math.pi

    @property
    def closed(self) -> bool:
        """A circle is closed."""
        return True

    @property
    def corners(self) -> Array:
        """A circle has none."""
        return np.empty(0)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, as :meth:`BoundaryCurve.evaluate`."""
        cosine, sine = self.radius * np.cos(t), self.radius * np.sin(t)
        return self.center[0] + cosine, self.center[1] + sine, -sine, cosine

    def nearest(self, x: Array, y: Array) -> Array:
        """The angle of the point, seen from the centre."""
        return np.arctan2(y - self.center[1], x - self.center[0])


@dataclass(frozen=True, kw_only=True)
class FormulaCurve:
    """A curve of :mod:`equimesh.domains.curve`, for t from 0 to 1; a :class:`BoundaryCurve`.

    Raises :class:`~equimesh.errors.InputError` with the field ``where`` for a closed curve whose ends are apart.
    """

    curve: Curve
    closed: bool = False
    where: str = field(default="domain.curves", compare=False)

    def __post_init__(self) -> None:
        x, y, x_t, y_t = self.curve.evaluate(np.array([0.0, 1.0]))
        gap = math.hypot(x[1] - x[0], y[1] - y[0])
        if self.closed and gap > MAX_GAP_SHARE * float(np.hypot(x_t, y_t).max()):
            raise InputError(
                f"the curve is named closed, but begins at ({x[0]:.6g}, {y[0]:.6g}) and ends at ({x[1]:.6g},"
                f' {y[1]:.6g}), {gap:.3g} apart: let t = 0 and t = 1 give one point, or leave out "closed"',
                field=self.where,
            )

    @property
    def corners(self) -> Array:
        """0, where a closed curve begins in another direction than it ends; the formulas are smooth elsewhere."""
        _, _, x_t, y_t = self.curve.evaluate(np.array([0.0, 1.0]))
        cross, along = x_t[0] * y_t[1] - y_t[0] * x_t[1], x_t[0] * x_t[1] + y_t[0] * y_t[1]
        is_corner = self.closed and abs(math.atan2(cross, along)) > MAX_BEND
        return np.zeros(1 if is_corner else 0)

    @property
    def ends(self) -> tuple[float, float]:
        """0 and 1."""
        return 0.0, 1.0

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, as :meth:`BoundaryCurve.evaluate`."""
        return self.curve.evaluate(wrapped(self, np.asarray(t, dtype=np.float64)))

    def nearest(self, x: Array, y: Array) -> Array:
        """The nearest of many points of the curve, refined."""
        return nearest_on(self, x, y, np.linspace(0.0, 1.0, SEARCH_POINTS))


def wrapped(curve: BoundaryCurve, t: Array) -> Array:
    """``t`` moved between the ends of a closed curve by whole turns; unchanged for an open one."""
    first, last = curve.ends
    return first + np.mod(t - first, last - first) if curve.closed else t


def nearest_on(curve: BoundaryCurve, x: Array, y: Array, places: Array) -> Array:
    """The t of the points of ``curve`` nearest to these points.

    The search begins at the nearest of ``places`` and goes on by golden sections between its neighbours, which are
    assumed to hold one smallest distance. On a closed curve these lie beyond its ends, too.
    """
    px, py = np.ravel(x).astype(np.float64), np.ravel(y).astype(np.float64)
    at_x, at_y, *_ = curve.evaluate(places)
    best = np.array([int(((at_x - a) ** 2 + (at_y - b) ** 2).argmin()) for a, b in zip(px, py, strict=True)], dtype=int)
    turn = places[-1] - places[0]
    beyond = (places[-2] - turn, places[1] + turn) if curve.closed else places[[0, -1]]
    around = np.concatenate([beyond[:1], places, beyond[1:]])
    low, high = around[best], around[best + 2]
    t = places[best]
    # Where the derivative of the squared distance changes its sign: bisection, which no kink disturbs.
    for _ in range(SEARCH_STEPS):
        cx, cy, x_t, y_t = curve.evaluate(t)
        rises = (cx - px) * x_t + (cy - py) * y_t > 0.0
        low, high = np.where(rises, low, t), np.where(rises, t, high)
        t = 0.5 * (low + high)
    ends = np.stack([t, places[best]])
    cx, cy, *_ = curve.evaluate(ends)
    distance = (cx - px) ** 2 + (cy - py) ** 2
    found = np.where(distance[0] <= distance[1], t, places[best])
    is_beyond = (found < places[0]) | (found > places[-1])
    return np.asarray(np.where(is_beyond, wrapped(curve, found), found)).reshape(np.shape(x))


# Parts of curves: from which t to which an edge runs, and where its nodes stand.

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
    """The t at the start and at the end of an edge between the places ``first`` and ``last``, shape ``(2,)``.

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
        table = scipy.interpolate.CubicHermiteSpline(t if t[1] > t[0] else -t, length, speed)
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


# Edges of cells that join two points of a boundary curve: the area between them and the curve.

SHARES = np.array([np.subtract(1.0, PLACES), PLACES])[:, None]
"""How far a piece moves at the ``PLACES`` where its first, and where its second node does, shape ``(2, 1, 5)``."""
MAX_DISTANCE_SHARE = 1e-6
"""The largest distance of a fixed node from a curve that it ends, as a share of the size of the curve."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Chords:
    """Edges between two points of one ``curve``: the two ``nodes`` of each, shape ``(edges, 2)``."""

    curve: BoundaryCurve
    nodes: IntArray
    fixed: Array
    """The parameters of nodes that are fixed, else NaN, shape ``(edges, 2)``."""
    turns: Array
    """What the parameter jumps by from the first to the second node, shape ``(edges,)``: turns of a closed curve."""

    @cached_property
    def slides(self) -> BoolArray:
        """Which nodes are not fixed, shape ``(edges, 2)``."""
        return np.isnan(self.fixed)

    @cached_property
    def ends(self) -> tuple[IntArray, IntArray, IntArray]:
        """The ends of edges that are not fixed: 0 for first and 1 for second nodes, their edges, and the nodes."""
        first_or_second, edges = np.nonzero(self.slides.T)
        return first_or_second, edges, self.nodes[edges, first_or_second]

    @classmethod
    def of(
        cls, curve: BoundaryCurve, edges: IntArray, slides: BoolArray, points: Array, parameters: Array
    ) -> Chords | None:
        """The chords of the ``edges`` with a node that ``slides`` on the curve; ``None`` for a line, or without any.

        ``slides`` and ``parameters`` have the shape ``(nodes,)``, ``points`` the shape ``(2, nodes)``. An edge whose
        other node is not on the curve is left out.
        """
        nodes = edges[slides[edges].any(axis=1)]
        if isinstance(curve, Line) or not nodes.size:
            return None
        (first, last), fixed = curve.ends, np.full(nodes.shape, math.nan)
        x, y, _, _ = curve.evaluate(np.linspace(first, last, 9))
        size, is_fixed = float(np.ptp(x) + np.ptp(y)), ~slides[nodes]
        at = points[:, nodes[is_fixed]]
        fixed[is_fixed] = curve.nearest(*at)
        there_x, there_y, _, _ = curve.evaluate(fixed[is_fixed])
        is_near = np.ones(nodes.shape, dtype=bool)
        is_near[is_fixed] = np.hypot(there_x - at[0], there_y - at[1]) <= MAX_DISTANCE_SHARE * size
        meets = math.hypot(x[-1] - x[0], y[-1] - y[0]) <= MAX_DISTANCE_SHARE * size
        begins, ends = np.where(is_fixed, fixed, parameters[nodes]).T
        turns = (last - first) * np.round((ends - begins) / (last - first)) if meets else np.zeros(len(nodes))
        kept = is_near.all(axis=1)
        return cls(curve=curve, nodes=nodes[kept], fixed=fixed[kept], turns=turns[kept])

    def places(self, parameters: Array, speed: float = 1.0) -> tuple[Array, Array]:
        """How far the parameter goes along each edge, shape ``(edges,)``, and the ``PLACES`` there, ``(edges, 5)``.

        ``parameters`` are those of all nodes times ``speed``, shape ``(nodes,)``; those of nodes on the curve are read.
        """
        begins, ends = np.where(self.slides, parameters[self.nodes] / speed, self.fixed).T
        lengths = ends - self.turns - begins
        return lengths, begins[:, None] + lengths[:, None] * SHARES[1]

    def pieces(self, parameters: Array) -> Pieces:
        """The pieces of the curve between the ends of the edges."""
        lengths, places = self.places(parameters)
        return Pieces(self, lengths, *self.curve.evaluate(places))


class Pieces:
    """Pieces of a curve at its ``chords``, with their ``lengths`` and the curve at their :meth:`Chords.places`."""

    def __init__(self, chords: Chords, lengths: Array, x: Array, y: Array, x_t: Array, y_t: Array) -> None:
        self._chords, self._lengths, self._curve = chords, lengths, (x, y, x_t, y_t)

    @cached_property
    def area(self) -> float:
        """The area between the curve and the edges."""
        return float(self._areas.sum())

    @cached_property
    def _areas(self) -> Array:
        return areas_between(*self._curve[:2])

    def derivatives(self, nodes: int) -> tuple[Array, Array]:
        """The derivatives of the area by the parameters of all nodes, and its second ones, shape ``(nodes,)`` each.

        The second ones are those of a parabola, whose area is like the third power of the length of the edge.
        """
        x, y, x_t, y_t = self._curve
        changes = changes_of_areas(x, y, SHARES * x_t, SHARES * y_t)
        squares = self._lengths**2
        second = np.divide(6.0 * self._areas, squares, out=np.zeros_like(squares), where=squares != 0.0)
        slopes, bends = np.zeros((2, nodes))
        first_or_second, edges, ends = self._chords.ends
        np.add.at(slopes, ends, changes[first_or_second, edges])
        np.add.at(bends, ends, second[edges])
        return slopes, bends
