"""A bicubic spline and its partial derivatives at scattered points, as compiled loops.

FITPACK computes the spline; this module evaluates it. FITPACK recomputes the B-splines for each value at each point,
which takes a microsecond. On a piece of an axis only four are not zero, and these are cubics: their coefficients are
computed once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array, IntArray

ORDER = 4  # B-splines that are not zero on a piece of an axis, and coefficients of a cubic
BUCKETS_PER_PIECE = 2
MAX_CACHED_KNOTS = 2100  # knots of the longest axis whose B-splines are kept for the next samples
COUNT = (1, 3, 6)
"""The number of values up to each order: u; u_x, u_y; u_xx, u_xy, u_yy."""


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

    def inside(self, t: Array, nowhere: npt.NDArray[np.bool_]) -> Array:
        """The points of the axis nearest to ``t``, in one row; any where ``t`` is ``nowhere``."""
        low, high = self.breaks[0], self.breaks[-1]
        return np.where(nowhere, low, np.clip(t, low, high)).ravel()


@dataclass(frozen=True, kw_only=True, eq=False)
class Bicubic:
    """A bicubic spline: ``coefficients[i, j]`` of the product of the i-th B-spline in x and the j-th in y.

    ``knots`` are those in x and in y.
    """

    knots: tuple[Array, Array]
    along_x: Axis
    along_y: Axis
    coefficients: Array

    @classmethod
    def of(cls, spline: RectBivariateSpline) -> Bicubic:
        """The same spline, which must be cubic in both directions."""
        knots_x, knots_y, coefficients = (np.ascontiguousarray(part, dtype=float) for part in spline.tck)
        return cls(
            knots=(knots_x, knots_y),
            along_x=Axis.between(knots_x),
            along_y=Axis.between(knots_y),
            coefficients=coefficients.reshape(len(knots_x) - ORDER, len(knots_y) - ORDER),
        )

    @property
    def steepest(self) -> tuple[float, float]:
        """Bounds of the derivatives by x and by y: the largest of their coefficients. NaN or infinite if those are."""
        c = self.coefficients
        return _steepest(c, self.knots[0]), _steepest(c.T, self.knots[1])

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """The spline and its partial derivatives up to ``order``, each of the points' shape; see :data:`COUNT`.

        Outside its rectangle the spline is taken at the nearest point of that; at NaN it is NaN.
        """
        x, y = np.broadcast_arrays(x, y)
        first, second = self.along_x, self.along_y
        nowhere = np.isnan(x) | np.isnan(y)
        values = np.empty((COUNT[order], *x.shape))
        at = first.inside(x, nowhere), second.inside(y, nowhere), first, second, self.coefficients
        rows = values.reshape(len(values), -1)
        if order == 0:
            fill_values(*at, rows)
        else:
            fill_slopes(*at, rows)
        if order == 2:
            fill_curvatures(*at, rows)
        values[:, nowhere] = np.nan
        return tuple(values)


@lru_cache(maxsize=64)
def _between(knots: bytes) -> Axis:
    """The pieces of an axis, cached: the samples of all time steps have the same axes."""
    return Axis.of(np.frombuffer(knots))


def _steepest(coefficients: Array, knots: Array) -> float:
    """The largest coefficient of the derivative along the first axis."""
    with np.errstate(all="ignore"):
        spans = (knots[ORDER:-1] - knots[1:-ORDER]) / (ORDER - 1)
        return float(np.abs(np.diff(coefficients, axis=0) / spans[:, None]).max())


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
def fill_values(x: Array, y: Array, along_x: Axis, along_y: Axis, coefficients: Array, rows: Array) -> None:
    """Fill the first of ``rows`` with the spline at points ``x``, ``y`` within the breaks."""
    (breaks_x, cubics_x, _), (breaks_y, cubics_y, _) = along_x, along_y
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        i, j = piece(x[p], along_x, scale_x), piece(y[p], along_y, scale_y)
        s, t = x[p] - breaks_x[i], y[p] - breaks_y[j]
        f0, f1, f2, f3 = at_piece(cubics_y, j, t)
        u = 0.0
        for k in range(ORDER):
            c0, c1, c2, c3 = cubics_x[i, k, 0], cubics_x[i, k, 1], cubics_x[i, k, 2], cubics_x[i, k, 3]
            row = coefficients[i + k, j] * f0 + coefficients[i + k, j + 1] * f1
            row += coefficients[i + k, j + 2] * f2 + coefficients[i + k, j + 3] * f3
            u += (c0 + s * (c1 + s * (c2 + s * c3))) * row
        rows[0, p] = u


@vectorised
def fill_slopes(x: Array, y: Array, along_x: Axis, along_y: Axis, coefficients: Array, rows: Array) -> None:
    """Fill the first three of ``rows`` with the spline and its first derivatives."""
    (breaks_x, cubics_x, _), (breaks_y, cubics_y, _) = along_x, along_y
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        i, j = piece(x[p], along_x, scale_x), piece(y[p], along_y, scale_y)
        s, t = x[p] - breaks_x[i], y[p] - breaks_y[j]
        f0, f1, f2, f3 = at_piece(cubics_y, j, t)
        g0, g1, g2, g3 = slopes_at_piece(cubics_y, j, t)
        u = u_x = u_y = 0.0
        for k in range(ORDER):
            c0, c1, c2, c3 = cubics_x[i, k, 0], cubics_x[i, k, 1], cubics_x[i, k, 2], cubics_x[i, k, 3]
            b, slope = c0 + s * (c1 + s * (c2 + s * c3)), c1 + s * (2.0 * c2 + s * 3.0 * c3)
            d0, d1 = coefficients[i + k, j], coefficients[i + k, j + 1]
            d2, d3 = coefficients[i + k, j + 2], coefficients[i + k, j + 3]
            row = d0 * f0 + d1 * f1 + d2 * f2 + d3 * f3
            u += b * row
            u_x += slope * row
            u_y += b * (d0 * g0 + d1 * g1 + d2 * g2 + d3 * g3)
        rows[0, p] = u
        rows[1, p] = u_x
        rows[2, p] = u_y


@vectorised
def fill_curvatures(x: Array, y: Array, along_x: Axis, along_y: Axis, coefficients: Array, rows: Array) -> None:
    """Fill the last three of six ``rows`` with the second derivatives."""
    (breaks_x, cubics_x, _), (breaks_y, cubics_y, _) = along_x, along_y
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        i, j = piece(x[p], along_x, scale_x), piece(y[p], along_y, scale_y)
        s, t = x[p] - breaks_x[i], y[p] - breaks_y[j]
        f, g = at_piece(cubics_y, j, t), slopes_at_piece(cubics_y, j, t)
        u_xx = u_xy = u_yy = 0.0
        for k in range(ORDER):
            c0, c1, c2, c3 = cubics_x[i, k, 0], cubics_x[i, k, 1], cubics_x[i, k, 2], cubics_x[i, k, 3]
            b, slope, bend = (
                c0 + s * (c1 + s * (c2 + s * c3)),
                c1 + s * (2.0 * c2 + s * 3.0 * c3),
                2.0 * c2 + s * 6.0 * c3,
            )
            for m in range(ORDER):
                c = coefficients[i + k, j + m]
                u_xx += c * bend * f[m]
                u_xy += c * slope * g[m]
                u_yy += c * b * (2.0 * cubics_y[j, m, 2] + t * 6.0 * cubics_y[j, m, 3])
        rows[3, p] = u_xx
        rows[4, p] = u_xy
        rows[5, p] = u_yy


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
