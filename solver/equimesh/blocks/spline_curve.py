"""Curves through points: cubic splines between corners, and lines of straight pieces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import scipy

from equimesh.blocks.curves import Point, nearest_on, wrapped
from equimesh.errors import InputError
from equimesh.numerics.types import Array, IntArray

# A line of points that turns by more at a point has a corner there, unless the corners are given.
CORNER_DEGREES = 60.0
# Points in a row must be this far apart, as a share of the length of the curve.
MIN_DISTANCE_SHARE = 1e-9
# Places between two points at which the search for the nearest point begins.
PLACES_BETWEEN = 4


@dataclass(frozen=True, kw_only=True)
class SplineCurve:
    """The cubic spline through ``points``; t is the length of the chords. A curve of boundaries.

    Between two ``corners``, numbers of points, the spline is smooth; at a corner its direction jumps. Unless they are
    given, corners are the points at which the chords turn by more than 60 degrees. ``closed`` says that the last point
    is the first one again. With ``straight`` the curve consists of the chords themselves.

    Raises :class:`~equimesh.errors.InputError` for fewer than 2 points, a point that repeats the one before, a
    corner that is no point, and a closed curve whose ends are apart. ``where`` is the field of these errors.
    """

    points: tuple[Point, ...]
    closed: bool = False
    corners_at: tuple[int, ...] | None = None
    straight: bool = False
    where: str = field(default="domain.curves", compare=False)
    corners: Array = field(init=False, repr=False, compare=False)
    _knots: Array = field(init=False, repr=False, compare=False)
    _place: scipy.interpolate.PPoly = field(init=False, repr=False, compare=False)
    _velocity: scipy.interpolate.PPoly = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64).reshape(-1, 2)
        self._check(points)
        if self.closed:
            points[-1] = points[0]
        corners = self._corner_numbers(points)
        last = len(points) - 1
        if self.closed and corners.size and corners[0] != 0:
            # A closed curve with corners begins at one of them, so that no smooth piece is cut.
            points = np.concatenate([points[corners[0] : -1], points[: corners[0] + 1]])
            corners = corners - corners[0]
        knots = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        if self.straight:
            slopes = np.diff(points, axis=0) / np.diff(knots)[:, None]
            place = scipy.interpolate.PPoly(np.stack([slopes, points[:-1]]), knots)
        elif self.closed and not corners.size:
            place = scipy.interpolate.CubicSpline(knots, points, bc_type="periodic")
        else:
            ends = np.union1d(corners, [0, last])
            pieces = [scipy.interpolate.CubicSpline(knots[a : b + 1], points[a : b + 1]) for a, b in pairwise(ends)]
            place = scipy.interpolate.PPoly(np.concatenate([piece.c for piece in pieces], axis=1), knots)
        for name, value in (("corners", knots[corners]), ("_knots", knots), ("_place", place)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_velocity", place.derivative())

    @property
    def ends(self) -> tuple[float, float]:
        """0 and the length of the chords."""
        return 0.0, float(self._knots[-1])

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x, y, x_t, y_t`` of the spline; beyond the ends of an open one it is continued."""
        at = wrapped(self, np.asarray(t, dtype=np.float64))
        place, velocity = self._place(at), self._velocity(at)
        return place[..., 0], place[..., 1], velocity[..., 0], velocity[..., 1]

    def nearest(self, x: Array, y: Array) -> Array:
        """The t of the nearest point of the curve."""
        inner = np.linspace(self._knots[:-1], self._knots[1:], PLACES_BETWEEN, endpoint=False, axis=1).ravel()
        return nearest_on(self, x, y, np.append(inner, self._knots[-1]))

    def _check(self, points: Array) -> None:
        """Refuse points through which no curve goes."""
        if len(points) < (4 if self.closed else 2):
            needed = "a closed curve needs 4 at least, the last one equal to the first" if self.closed else "2 at least"
            raise InputError(f"the curve has {len(points)} points: {needed}", field=self.where)
        chords = np.hypot(*np.diff(points, axis=0).T)
        size = float(chords.sum())
        if (chords <= MIN_DISTANCE_SHARE * size).any():
            k = int((chords <= MIN_DISTANCE_SHARE * size).argmax())
            at = f"({points[k, 0]:.6g}, {points[k, 1]:.6g})"
            message = f"points[{k + 1}] repeats points[{k}] = {at}: leave one of them out"
            raise InputError(message, field=self.where)
        gap = float(np.hypot(*(points[-1] - points[0])))
        if self.closed and gap > MIN_DISTANCE_SHARE * size:
            raise InputError(
                f"the curve is named closed, but begins at ({points[0, 0]:.6g}, {points[0, 1]:.6g}) and ends at"
                f" ({points[-1, 0]:.6g}, {points[-1, 1]:.6g}), {gap:.3g} apart: repeat the first point at the end, or"
                ' leave out "closed"',
                field=self.where,
            )

    def _corner_numbers(self, points: Array) -> IntArray:
        """The numbers of the corners, sorted; 0 stands for both ends of a closed curve."""
        count = len(points) - 1 if self.closed else len(points)
        if self.corners_at is not None:
            for k in self.corners_at:
                if not -count <= k < len(points):
                    message = f"corners has {k}, but the points have the numbers 0 to {len(points) - 1}"
                    raise InputError(message, field=self.where)
            return np.unique(np.array([k % count for k in self.corners_at], dtype=np.int64))
        chords = np.diff(points, axis=0)
        before = np.roll(chords, 1, axis=0) if self.closed else chords[:-1]
        after = chords if self.closed else chords[1:]
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        turns = np.degrees(np.abs(np.arctan2(cross, (before * after).sum(axis=1))))
        limit = 1e-6 if self.straight else CORNER_DEGREES
        return np.flatnonzero(turns > limit) + (0 if self.closed else 1)


def as_points(values: Sequence[Sequence[float]] | Array) -> tuple[Point, ...]:
    """Rows ``x, y`` as a tuple of pairs of floats."""
    return tuple((float(x), float(y)) for x, y in values)
