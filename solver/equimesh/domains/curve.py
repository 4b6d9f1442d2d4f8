"""Curves in the plane, the sides of a quadrilateral: two formulas in t, or a spline through points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt
import scipy

from equimesh.domains.domain import MAX_COORDINATE, Interval
from equimesh.errors import ExpressionError, InputError, SamplesError
from equimesh.formulas.poles import find_pole
from equimesh.formulas.program import Program, check_parameters, compile_formula, raise_culprit
from equimesh.formulas.vocabulary import CURVE, LIMITS
from equimesh.inputs import count_noun, real_array
from equimesh.numerics.types import Array

CHECK_POINTS = 257  # values of t at which a formula is checked to be finite
POLE_SAMPLES = 33
PANELS = 64  # equal parts of [0, 1]; a formula is assumed smooth on each
MAX_POINTS = 10_000
MIN_DISTANCE_SHARE = 1e-9  # distance of two points in a row, as a share of the length of the curve
SEARCH_POINTS = 1025  # of the first search for the ends of the box
ZOOM_POINTS = 33  # of each closer search
ZOOMS = 8  # closer searches


class Path(Protocol):
    """A point and its velocity as functions of t: the contents of a curve."""

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` at values of t of any shape; beyond [0, 1] they need not be finite."""
        ...

    @property
    def breaks(self) -> Array:
        """Values of t from 0 to 1; the path is assumed smooth between them."""
        ...


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A curve of the plane, for t from 0 to 1. Build it by :meth:`of_expressions` or :meth:`through`."""

    path: Path

    @classmethod
    def of_expressions(
        cls, x: str, y: str, parameters: Mapping[str, float] = MappingProxyType({}), *, side: str = ""
    ) -> Curve:
        """The curve of the points ``(x(t), y(t))``, given by two formulas in ``t`` such as ``"cos(pi*t/2)"``.

        Their language is that of :class:`~equimesh.fields.expression.Expression`, with the variable t alone. ``side``
        names the side of a domain that the curve will be: errors then have the field ``domain.<side>.x``, not ``x``.
        Raises :class:`~equimesh.errors.ExpressionError`, with the position in the text, for text that is not in the
        language, and where a coordinate or its slope is not finite on [0, 1].
        """
        with _pointing(side):
            return cls(path=FormulaPath(x=x, y=y, parameters=parameters))

    @classmethod
    def through(cls, points: npt.ArrayLike, *, side: str = "") -> Curve:
        """The cubic spline through ``points`` of shape ``(n, 2)``, in that order; two points give a straight line.

        Its parameter is the length of the chords; for points at distance h of a smooth curve it is accurate to O(h^4).
        ``side`` is that of :meth:`of_expressions`. Raises :class:`~equimesh.errors.SamplesError` with the field
        ``points``, which names the first bad one.
        """
        with _pointing(side):
            return cls(path=_spline_path(points))

    def evaluate(self, t: npt.ArrayLike) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` at values of t of any shape.

        Beyond [0, 1] formulas and splines are continued; where they are not finite, along the tangent.
        """
        ts = np.asarray(t, dtype=np.float64)
        parts = self.path.evaluate(ts)
        lost = ~np.isfinite(sum(parts)) & np.isfinite(ts)
        if not lost.any():
            return parts
        held = np.clip(ts, 0.0, 1.0)
        x, y, x_t, y_t = self.path.evaluate(held)
        tangent = (x + (ts - held) * x_t, y + (ts - held) * y_t, x_t, y_t)
        first, second, third, fourth = (np.where(lost, a, b) for a, b in zip(tangent, parts, strict=True))
        return first, second, third, fourth

    @property
    def box(self) -> tuple[Interval, Interval]:
        """The smallest box ``((x0, x1), (y0, y1))`` that holds the curve, to rounding."""
        ends = [[sign * self._furthest(axis, sign) for sign in (-1.0, 1.0)] for axis in (0, 1)]
        return (ends[0][0], ends[0][1]), (ends[1][0], ends[1][1])

    def _furthest(self, axis: int, sign: float) -> float:
        """The largest of ``sign`` times a coordinate: a search on many points, refined around the best one."""
        t = np.union1d(np.linspace(0.0, 1.0, SEARCH_POINTS), self.path.breaks)
        for _ in range(ZOOMS):
            values = sign * self.path.evaluate(t)[axis]
            best = int(values.argmax())
            t = np.linspace(t[max(best - 1, 0)], t[min(best + 1, t.size - 1)], ZOOM_POINTS)
        return float(values[best])


@dataclass(frozen=True, kw_only=True)
class FormulaPath:
    """The points ``(x(t), y(t))`` of two formulas; a :class:`Path`, see :meth:`Curve.of_expressions`."""

    x: str
    y: str
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)
    _programs: tuple[Program, Program] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        parameters = check_parameters(self.parameters)
        object.__setattr__(self, "parameters", MappingProxyType(parameters))
        programs = []
        for name, text in (("x", self.x), ("y", self.y)):
            try:
                programs.append(compile_formula(text, parameters, CURVE))
                _check_finite(name, programs[-1])
            except ExpressionError as error:
                raise ExpressionError(error.message, position=error.position, field=name) from None
        object.__setattr__(self, "_programs", tuple(programs))

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (self.x, self.y, dict(self.parameters))

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t``, exactly differentiated."""
        flat = t.ravel()
        (x, x_t, _), (y, y_t, _) = (program.evaluate(flat, flat, 1) for program in self._programs)
        return x.reshape(t.shape), y.reshape(t.shape), x_t.reshape(t.shape), y_t.reshape(t.shape)

    @property
    def understood(self) -> tuple[str, str]:
        """Both formulas as they were understood; see :attr:`~equimesh.fields.expression.Expression.understood`."""
        x, y = self._programs
        return x.understood, y.understood

    @property
    def breaks(self) -> Array:
        """The ends of equal parts: the kinks of a formula are not known."""
        return np.linspace(0.0, 1.0, PANELS + 1)


@dataclass(frozen=True, kw_only=True)
class SplinePath:
    """The cubic spline through ``points``, reached at the values ``knots`` of t; a :class:`Path`.

    A ``closed`` one goes on smoothly from its last point, which is the first one again.
    """

    points: tuple[tuple[float, float], ...]
    knots: tuple[float, ...]
    closed: bool = False
    _splines: tuple[Any, Any] = field(init=False, repr=False, compare=False)  # the point and its velocity

    def __post_init__(self) -> None:
        ends: Literal["periodic", "not-a-knot"] = "periodic" if self.closed else "not-a-knot"
        spline = scipy.interpolate.CubicSpline(np.array(self.knots), np.array(self.points), bc_type=ends)
        object.__setattr__(self, "_splines", (spline, spline.derivative()))

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` of the spline."""
        place, velocity = (spline(t) for spline in self._splines)
        return place[..., 0], place[..., 1], velocity[..., 0], velocity[..., 1]

    @property
    def breaks(self) -> Array:
        """The values of t at the points."""
        return np.array(self.knots)


def _restore(x: str, y: str, parameters: dict[str, float]) -> FormulaPath:
    return FormulaPath(x=x, y=y, parameters=parameters)


@contextmanager
def _pointing(side: str) -> Iterator[None]:
    """Errors raised inside have their field below ``domain.<side>``."""
    try:
        yield
    except InputError as error:
        if side:
            error.field = f"domain.{side}.{error.field}"
        raise


def _evaluate(program: Program, x: Array, y: Array, order: int) -> tuple[Array, ...]:
    """The derivatives of a coordinate, at points in arrays of any shape."""
    return tuple(part.reshape(x.shape) for part in program.evaluate(x.ravel(), y.ravel(), order))


def _check_finite(name: str, program: Program) -> None:
    """Refuse a coordinate that is not finite, or not differentiable, somewhere on [0, 1]."""
    t = np.linspace(0.0, 1.0, CHECK_POINTS)
    value, slope, _ = program.evaluate(t, t, 1)
    for what, found, largest in (
        (f"{name}(t)", value, MAX_COORDINATE),
        (f"the slope of {name}(t)", slope, LIMITS.magnitude),
    ):
        bad = ~(np.abs(found) <= largest)
        if bad.any():
            k = int(bad.argmax())
            wrong = f"is larger than {largest:g}" if np.isfinite(found[k]) else "is not finite"
            at = float(t[k])
            raise_culprit(program, (at, at), f"{what} {wrong} at t = {at:.6g}", largest, where="curve")
    pole = find_pole(partial(_evaluate, program), POLE_SAMPLES)
    if pole is not None:
        wrong = f"the slope of {name}(t) grows without bound at t = {pole.x:.6g}"
        raise_culprit(program, (pole.x, pole.x), wrong, float(np.sqrt(pole.slope)), where="curve")


def _spline_path(points: npt.ArrayLike) -> SplinePath:
    """The path through points, which are checked."""
    places = real_array(points, "points", ndim=2)
    if places.shape[1] != 2:
        raise SamplesError(f"points has shape {places.shape}: it must be (n, 2), one row x, y each", field="points")
    if not 2 <= len(places) <= MAX_POINTS:
        raise SamplesError(
            f"the curve has {count_noun(len(places), 'point')}: 2 give a straight line, 4 or more a cubic spline,"
            f" and {MAX_POINTS} is the limit",
            field="points",
        )
    if np.abs(places).max() > MAX_COORDINATE:
        i, k = np.argwhere(np.abs(places) > MAX_COORDINATE)[0]
        raise SamplesError(
            f"points[{i}][{k}] = {places[i, k]:.6g}: the largest size of a coordinate is {MAX_COORDINATE:g}",
            field="points",
        )
    chords = np.hypot(*np.diff(places, axis=0).T)
    length = np.concatenate([[0.0], np.cumsum(chords)])
    if np.any(chords <= MIN_DISTANCE_SHARE * length[-1]):
        i = int(np.argmax(chords <= MIN_DISTANCE_SHARE * length[-1]))
        raise SamplesError(
            f"points[{i + 1}] repeats points[{i}] = ({places[i, 0]:.6g}, {places[i, 1]:.6g}): leave one of them out",
            field="points",
        )
    knots = length / length[-1]
    return SplinePath(points=tuple((float(x), float(y)) for x, y in places), knots=tuple(map(float, knots)))


# The seam of a domain between four curves: two opposite sides that are one curve, on which the other two close.
#
# Lines around an O-grid then have no end. A line that is closed needs a curve that runs smoothly through the seam,
# since no node stays there.

PAIRS = (("left", "right"), ("bottom", "top"))
"""The sides that can be a seam: of closed xi-lines, and of closed eta-lines."""
SEAM_POINTS = 129
"""Points of a seam at which both of its sides must be at one place."""
MAX_SEAM_GAP = 1e-9
"""The largest distance of the two sides there, as a share of the size of the domain."""
MAX_TURN = 60.0
"""The largest angle in degrees between the first and the last chord of points that a smooth curve goes through."""
MAX_VELOCITY_JUMP = 1e-3
"""The largest difference of the velocities at both ends of a closed curve, as a share of the larger one."""
BY_BLOCKS = (
    "begin the curve at a smooth place; or give the O-grid as blocks, whose description keeps a node at each of its"
    " 'corners', and solve on Blocks.of(...)"
)
"""The remedy for a corner at a seam."""


def seam_of(sides: Mapping[str, Curve], size: float) -> int:
    """The direction of the closed lines: 0 where left and right are one curve, 1 where bottom and top are.

    Raises :class:`~equimesh.errors.InputError` with the field ``"domain.closed"`` where no pair is one curve.
    """
    t = np.linspace(0.0, 1.0, SEAM_POINTS)
    gaps = [_gap(sides[one].evaluate(t)[:2], sides[other].evaluate(t)[:2]) for one, other in PAIRS]
    axis = int(np.argmin(gaps))
    if gaps[axis] <= MAX_SEAM_GAP * size:
        return axis
    raise InputError(
        f"closed = True, but no two opposite sides are one curve: left and right are up to {gaps[0]:.3g} apart at the"
        f" same t, bottom and top up to {gaps[1]:.3g}; give the curve at which the ring is cut twice, as left and right"
        " (then bottom and top close) or as bottom and top (then left and right close), or leave closed out",
        field="domain.closed",
    )


def closed_curve(curve: Curve, side: str) -> Curve:
    """The curve of a ``side`` that ends where it begins; a spline through points goes on smoothly there.

    Raises :class:`~equimesh.errors.InputError` with the field ``"domain.<side>"`` where it has a corner.
    """
    if isinstance(curve.path, SplinePath):
        return curve if curve.path.closed else Curve(path=_closed_spline(curve.path, side))
    x, y, *velocity = curve.evaluate(np.array([0.0, 1.0]))
    first, last = np.array(velocity).T
    if np.hypot(*(first - last)) > MAX_VELOCITY_JUMP * max(np.hypot(*first), np.hypot(*last)):
        raise InputError(
            f"{side} begins at ({x[0]:.6g}, {y[0]:.6g}) with the slope ({first[0]:.4g}, {first[1]:.4g}), but ends"
            f" there with ({last[0]:.4g}, {last[1]:.4g}): a closed line has no node that stays at this place;"
            f" {BY_BLOCKS}",
            field=f"domain.{side}",
        )
    return curve


def _closed_spline(path: SplinePath, side: str) -> SplinePath:
    places = np.array(path.points)
    first, last = places[1] - places[0], places[-1] - places[-2]
    turn = float(np.degrees(abs(np.arctan2(first[0] * last[1] - first[1] * last[0], first @ last))))
    if turn > MAX_TURN:
        raise InputError(
            f"{side} has a corner of {180.0 - turn:.3g} degrees at ({places[0, 0]:.6g}, {places[0, 1]:.6g}), where it"
            f" begins and ends: a closed line has no node that stays there; {BY_BLOCKS}",
            field=f"domain.{side}",
        )
    return replace(path, points=(*path.points[:-1], path.points[0]), closed=True)


def _gap(one: tuple[Array, ...], other: tuple[Array, ...]) -> float:
    return float(np.hypot(one[0] - other[0], one[1] - other[1]).max())
