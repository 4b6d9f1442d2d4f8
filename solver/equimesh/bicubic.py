"""A bicubic spline and its partial derivatives at scattered points, as compiled loops.

The spline itself is FITPACK's. What is here only evaluates it: FITPACK works out the B-splines anew for each value of
each point, a microsecond every time, while on a piece of an axis the four that are not zero are four cubics, which can
be written down once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from equimesh.compiled import vectorised

Array: TypeAlias = npt.NDArray[np.float64]
Indices: TypeAlias = npt.NDArray[np.int64]

ORDER = 4  # B-splines that are not zero on a piece of an axis, and coefficients of a cubic
BUCKETS = 2  # per piece
COUNT = (1, 3, 6)
"""How many values there are up to each order: u; u_x, u_y; u_xx, u_xy, u_yy."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """The pieces of one axis, between ``breaks`` of shape ``(n + 1,)``, and the cubic B-splines on them.

    ``cubics[i, j, k]``, of shape ``(n, 4, 4)``, is the coefficient of ``(t - breaks[i])**k`` of the j-th B-spline that
    is not zero on piece i. ``first[b]`` is the piece where the b-th of equally wide buckets begins.
    """

    breaks: Array
    cubics: Array
    first: Indices

    @classmethod
    def between(cls, knots: Array) -> Pieces:
        """The pieces between the ``knots`` of cubic B-splines, of which the first and the last come four times."""
        breaks = np.ascontiguousarray(knots[ORDER - 1 : len(knots) - ORDER + 1])
        starts = np.linspace(breaks[0], breaks[-1], BUCKETS * (len(breaks) - 1) + 1)
        first = np.clip(np.searchsorted(breaks, starts, side="right") - 1, 0, len(breaks) - 2)
        return cls(breaks=breaks, cubics=_cubics(knots), first=first.astype(np.int64))

    def inside(self, t: Array, nowhere: npt.NDArray[np.bool_]) -> Array:
        """The points of the axis nearest to ``t``, in one row; any where ``t`` is ``nowhere``."""
        low, high = self.breaks[0], self.breaks[-1]
        return np.where(nowhere, low, np.clip(t, low, high)).ravel()


@dataclass(frozen=True, kw_only=True, eq=False)
class Bicubic:
    """A bicubic spline: ``coefficients[i, j]`` of the product of the i-th B-spline in x and the j-th in y."""

    along_x: Pieces
    along_y: Pieces
    coefficients: Array

    @classmethod
    def of(cls, spline: RectBivariateSpline) -> Bicubic:
        """The same spline, which must be cubic in both directions."""
        knots_x, knots_y, coefficients = (np.ascontiguousarray(part, dtype=float) for part in spline.tck)
        return cls(
            along_x=Pieces.between(knots_x),
            along_y=Pieces.between(knots_y),
            coefficients=coefficients.reshape(len(knots_x) - ORDER, len(knots_y) - ORDER),
        )

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """The spline and its partial derivatives up to ``order``, each of the points' shape; see :data:`COUNT`.

        Outside its rectangle the spline is taken at the nearest point of that; at NaN it is NaN.
        """
        x, y = np.broadcast_arrays(x, y)
        first, second = self.along_x, self.along_y
        nowhere = np.isnan(x) | np.isnan(y)
        values = np.empty((COUNT[order], *x.shape))
        evaluate(
            first.inside(x, nowhere), second.inside(y, nowhere),
            first.breaks, first.cubics, first.first, second.breaks, second.cubics, second.first,
            self.coefficients, values.reshape(len(values), -1),
        )  # fmt: skip
        values[:, nowhere] = np.nan
        return tuple(values)


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
def evaluate(
    x: Array, y: Array,
    breaks_x: Array, cubics_x: Array, first_x: Indices, breaks_y: Array, cubics_y: Array, first_y: Indices,
    coefficients: Array, values: Array,
) -> None:  # fmt: skip
    """Fill ``values``, of one row for each derivative, at points ``x``, ``y`` within the breaks."""
    rows = values.shape[0]
    along_x, along_y = np.zeros((3, ORDER)), np.zeros((3, ORDER))
    scale_x = (first_x.size - 1) / (breaks_x[-1] - breaks_x[0])
    scale_y = (first_y.size - 1) / (breaks_y[-1] - breaks_y[0])
    for p in range(x.size):
        i = basis(x[p], breaks_x, cubics_x, first_x, scale_x, rows, along_x)
        j = basis(y[p], breaks_y, cubics_y, first_y, scale_y, rows, along_y)
        u = u_x = u_y = 0.0
        for k in range(ORDER):
            v = v_y = 0.0
            for m in range(ORDER):
                v += coefficients[i + k, j + m] * along_y[0, m]
                v_y += coefficients[i + k, j + m] * along_y[1, m]
            u += along_x[0, k] * v
            u_x += along_x[1, k] * v
            u_y += along_x[0, k] * v_y
        values[0, p] = u
        if rows > 1:
            values[1, p] = u_x
            values[2, p] = u_y
        if rows > 3:
            u_xx = u_xy = u_yy = 0.0
            for k in range(ORDER):
                for m in range(ORDER):
                    c = coefficients[i + k, j + m]
                    u_xx += c * along_x[2, k] * along_y[0, m]
                    u_xy += c * along_x[1, k] * along_y[1, m]
                    u_yy += c * along_x[0, k] * along_y[2, m]
            values[3, p] = u_xx
            values[4, p] = u_xy
            values[5, p] = u_yy


@vectorised
def basis(t: float, breaks: Array, cubics: Array, first: Indices, scale: float, rows: int, found: Array) -> int:
    """The piece of the point ``t``; its B-splines there, and for more ``rows`` their derivatives, go to ``found``."""
    last = breaks.size - 2
    bucket = min(int((t - breaks[0]) * scale), first.size - 2)
    low, high = first[bucket], min(first[bucket + 1] + 1, last)
    # The piece is the last one that begins at or before t; at the edge of a bucket rounding may miss it.
    while low > 0 and t < breaks[low]:
        low -= 1
    while low < high:
        middle = (low + high + 1) // 2
        if breaks[middle] <= t:
            low = middle
        else:
            high = middle - 1
    s = t - breaks[low]
    for j in range(ORDER):
        a, b, c, d = cubics[low, j, 0], cubics[low, j, 1], cubics[low, j, 2], cubics[low, j, 3]
        found[0, j] = a + s * (b + s * (c + s * d))
        if rows > 1:
            found[1, j] = b + s * (2.0 * c + s * 3.0 * d)
        if rows > 3:
            found[2, j] = 2.0 * c + s * 6.0 * d
    return int(low)
