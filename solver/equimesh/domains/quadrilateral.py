"""A domain between four curves: the Coons patch, which blends each pair of opposite sides linearly.

W. J. Gordon and C. A. Hall, *Construction of curvilinear coordinate systems and applications to mesh generation*,
Int. J. Numer. Meth. Engng 7 (1973).
"""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from equimesh.domains.curve import PAIRS, Curve, closed_curve, seam_of
from equimesh.domains.domain import OPEN, Interval, check_extent
from equimesh.errors import InputError
from equimesh.inputs import require_flag
from equimesh.meshes.nested import Closed
from equimesh.numerics.types import Array

CORNERS = {  # (s, t) of the corner, and the two sides that meet there, each with its value of t
    (0, 0): (("bottom", 0.0), ("left", 0.0)),
    (1, 0): (("bottom", 1.0), ("right", 0.0)),
    (1, 1): (("top", 1.0), ("right", 1.0)),
    (0, 1): (("top", 0.0), ("left", 1.0)),
}
MAX_CORNER_GAP = 1e-9  # distance of sides at a corner, as a share of the size of the domain
CHECK_POINTS = 257  # points a direction at which the Jacobian must be positive
MIN_DETERMINANT_SHARE = 1e-6  # the smallest determinant there, as a share of the mean one
SIDE_SEGMENTS = 128  # of each side, in the search for crossings
AREA_ROUNDING = 1e-13  # as a share of the square of the size: sides may touch, for instance where a ring is cut
GAUSS = np.polynomial.legendre.leggauss(5)


@dataclass(frozen=True, kw_only=True)
class Quadrilateral:
    """The domain between four curves. ``bottom`` and ``top`` run from left to right, ``left`` and ``right`` upwards.

    Implements :class:`~equimesh.domains.domain.Domain`: s runs along bottom and top, t along left and right. A point is
    the sum of two linear blends, of bottom with top and of left with right, minus the bilinear blend of the corners.

    ``closed`` makes an O-grid: left and right are one curve, the seam, and bottom and top are closed curves; or bottom
    and top are the seam, and left and right are closed. Lines go on across the seam, which is free to bend, and splines
    through the points of closed curves are smooth there.

    Raises :class:`~equimesh.errors.InputError` where sides do not meet at a corner (field ``"domain.<side>"``), cross
    each other, or where the map folds (field ``"domain"``); the message names the place. It also raises it for a closed
    one that has no seam (field ``"domain.closed"``), or a corner there.
    """

    bottom: Curve
    right: Curve
    top: Curve
    left: Curve
    closed: bool = False
    closed_lines: Closed = field(init=False, repr=False, compare=False)
    box: tuple[Interval, Interval] = field(init=False, repr=False, compare=False)
    area: float = field(init=False, repr=False, compare=False)
    _corners: Array = field(init=False, repr=False, compare=False)  # [s, t, coordinate]

    def __post_init__(self) -> None:
        for name in ("bottom", "right", "top", "left"):
            if not isinstance(getattr(self, name), Curve):
                message = f"{name} must be a Curve: Curve.of_expressions(x, y) or Curve.through(points)"
                raise InputError(message, field=f"domain.{name}")
        require_flag(self.closed, "closed", "domain.")
        boxes = np.array([curve.box for curve in (self.bottom, self.right, self.top, self.left)])
        low, high = boxes[:, :, 0].min(axis=0), boxes[:, :, 1].max(axis=0)
        for k, name in enumerate("xy"):
            check_extent((float(low[k]), float(high[k])), name, "domain")
        object.__setattr__(self, "box", tuple((float(a), float(b)) for a, b in zip(low, high, strict=True)))
        object.__setattr__(self, "_corners", self._meet(float((high - low).max())))
        object.__setattr__(self, "closed_lines", self._close(float((high - low).max())))
        self._check_folds()
        self._check_crossings()
        object.__setattr__(self, "area", self._enclosed())

    def map(self, s: Array, t: Array) -> tuple[Array, Array]:
        """The physical points, as :meth:`equimesh.domains.domain.Domain.map`."""
        x, y, *_ = self._patch(*self._inside(s, t))
        return x, y

    def jacobian(self, s: Array, t: Array) -> tuple[Array, Array, Array, Array]:
        """``x_s, x_t, y_s, y_t``, from the exact slopes of the curves."""
        _, _, x_s, x_t, y_s, y_t = self._patch(*self._inside(s, t))
        return x_s, x_t, y_s, y_t

    def _inside(self, s: npt.ArrayLike, t: npt.ArrayLike) -> tuple[npt.ArrayLike, npt.ArrayLike]:
        """The same points, less whole turns of closed lines."""
        along_s, along_t = self.closed_lines
        return _less_turns(s) if along_s else s, _less_turns(t) if along_t else t

    def _close(self, size: float) -> Closed:
        """The closed lines; the curves along them become smooth at the seam."""
        if not self.closed:
            return OPEN
        axis = seam_of({name: getattr(self, name) for pair in PAIRS for name in pair}, size)
        for name in PAIRS[1 - axis]:
            object.__setattr__(self, name, closed_curve(getattr(self, name), name))
        return axis == 0, axis == 1

    def _patch(self, s: npt.ArrayLike, t: npt.ArrayLike) -> tuple[Array, Array, Array, Array, Array, Array]:
        """``x, y, x_s, x_t, y_s, y_t`` at points of any shape."""
        s, t = np.asarray(s, dtype=np.float64), np.asarray(t, dtype=np.float64)
        bottom, top = self.bottom.evaluate(s), self.top.evaluate(s)
        left, right = self.left.evaluate(t), self.right.evaluate(t)
        values, along_s, along_t = [], [], []
        for k in (0, 1):
            (c00, c01), (c10, c11) = self._corners[..., k]
            from_left, from_right = left[k] - (1 - t) * c00 - t * c01, right[k] - (1 - t) * c10 - t * c11
            values.append((1 - t) * bottom[k] + t * top[k] + (1 - s) * from_left + s * from_right)
            along_s.append((1 - t) * bottom[k + 2] + t * top[k + 2] + from_right - from_left)
            chord_left, chord_right = left[k + 2] - (c01 - c00), right[k + 2] - (c11 - c10)
            along_t.append(top[k] - bottom[k] + (1 - s) * chord_left + s * chord_right)
        return values[0], values[1], along_s[0], along_t[0], along_s[1], along_t[1]

    def _meet(self, size: float) -> Array:
        """The four corners; refuses sides that do not meet there."""
        corners = np.empty((2, 2, 2))
        for (i, j), ((first, at), (second, then)) in CORNERS.items():
            one = np.array([part.item() + 0.0 for part in getattr(self, first).evaluate(at)[:2]])
            other = np.array([part.item() + 0.0 for part in getattr(self, second).evaluate(then)[:2]])
            if np.abs(one - other).max() > MAX_CORNER_GAP * size:
                verbs = ["ends" if end else "starts" for end in (at, then)]
                raise InputError(
                    f"{first} {verbs[0]} at ({one[0]:.9g}, {one[1]:.9g}), but {second} {verbs[1]} at"
                    f" ({other[0]:.9g}, {other[1]:.9g}): the sides must meet at their corner; bottom and top run from"
                    " left to right, left and right from bottom to top",
                    field=f"domain.{second}",
                )
            corners[i, j] = 0.5 * (one + other)
        return corners

    def _check_folds(self) -> None:
        """Refuse a map whose Jacobian is not positive on a fine grid."""
        axis = np.linspace(0.0, 1.0, CHECK_POINTS)
        x, y, x_s, x_t, y_s, y_t = self._patch(axis[:, None], axis[None, :])
        determinant = x_s * y_t - x_t * y_s
        if np.all(determinant < 0.0):
            raise InputError(
                "the sides run clockwise around the domain, so that the map mirrors: exchange bottom with left, and top"
                " with right",
                field="domain",
            )
        if determinant.min() > MIN_DETERMINANT_SHARE * np.abs(determinant).mean():
            return
        i, j = np.unravel_index(int(determinant.argmin()), determinant.shape)
        what = "folds" if determinant[i, j] < -MIN_DETERMINANT_SHARE * np.abs(determinant).mean() else "is flat"
        at = f"({x[i, j] + 0.0:.6g}, {y[i, j] + 0.0:.6g})"
        raise InputError(
            f"the map {what} at (x, y) = {at}, {_place(axis[i], axis[j])}: its Jacobian there is"
            f" {determinant[i, j]:.3g}; move the sides apart, make opposite sides run through t at like speed, and let"
            " sides meet at an angle below 180 degrees",
            field="domain",
        )

    def _check_crossings(self) -> None:
        """Refuse a boundary that crosses itself: the map would cover some points twice."""
        t = np.linspace(0.0, 1.0, SIDE_SEGMENTS + 1)
        round_trip = (self.bottom, 1), (self.right, 1), (self.top, -1), (self.left, -1)
        lines = [np.column_stack(curve.evaluate(t)[:2])[::way] for curve, way in round_trip]
        rim = np.concatenate([line[:-1] for line in lines])
        a, b = rim, np.roll(rim, -1, axis=0)
        starts, ends = (_turn(a[:, None], b[:, None], p[None, :]) for p in (a, b))
        apart = AREA_ROUNDING * float(np.ptp(rim, axis=0).max()) ** 2
        astride = (np.minimum(starts, ends) < -apart) & (np.maximum(starts, ends) > apart)
        crossing = astride & astride.T
        number = np.arange(len(rim))
        steps = np.abs(number[:, None] - number)
        crossing &= (steps > 1) & (steps < len(rim) - 1)
        if crossing.any():
            i, j = np.argwhere(crossing)[0]
            sides = ("bottom", "right", "top", "left")
            one, other = sides[i // SIDE_SEGMENTS], sides[j // SIDE_SEGMENTS]
            who = f"{one} crosses itself" if one == other else f"{one} and {other} cross"
            at = f"({a[i, 0] + 0.0:.6g}, {a[i, 1] + 0.0:.6g})"
            raise InputError(f"{who} near (x, y) = {at}: the sides may meet at the corners only", field="domain")

    def _enclosed(self) -> float:
        """The area inside the four curves, ``1/2`` of the integral of ``x dy - y dx`` around it."""
        total = 0.0
        for curve, way in ((self.bottom, 1), (self.right, 1), (self.top, -1), (self.left, -1)):
            breaks = curve.path.breaks
            half, middle = 0.5 * np.diff(breaks), 0.5 * (breaks[1:] + breaks[:-1])
            x, y, x_t, y_t = curve.evaluate(middle[:, None] + half[:, None] * GAUSS[0])
            (x0, y0) = self._corners[0, 0]  # near by, so that little is lost to cancellation
            total += way * float(np.sum(half[:, None] * GAUSS[1] * ((x - x0) * y_t - (y - y0) * x_t)))
        return 0.5 * total


def _less_turns(s: npt.ArrayLike) -> Array:
    """A coordinate of the reference square without whole turns; values from 0 to 1 to the last bit."""
    s = np.asarray(s, dtype=np.float64)
    inside = (s >= 0.0) & (s <= 1.0)
    return s if inside.all() else np.where(inside, s, s - np.floor(s))


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Twice the area of the triangles abc: positive where they are counter-clockwise."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _place(s: float, t: float) -> str:
    """A point of the reference square in words: a corner, a place on a side, or inside."""
    across = {0.0: "left", 1.0: "right"}.get(float(s), "")
    upwards = {0.0: "bottom", 1.0: "top"}.get(float(t), "")
    if across and upwards:
        return f"the corner of {upwards} and {across}"
    if across or upwards:
        return f"on {across or upwards} at t = {t if across else s:.6g}"
    return f"inside, {s:.6g} of the way from left to right and {t:.6g} from bottom to top"
