"""A bicubic spline and its partial derivatives at scattered points, as compiled loops.

FITPACK computes the spline; this module evaluates it. FITPACK recomputes the B-splines for each value at each point,
which takes a microsecond. On a piece of an axis only four are not zero, and these are cubics: their coefficients are
computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import scipy

from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array, IntArray, Pair

# One axis of a bicubic spline: its pieces, and the cubic B-splines on them.

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
        breaks = knots[ORDER - 1 : len(knots) - ORDER + 1].copy()  # never read-only, or loops are compiled twice
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


# A bicubic spline as one polynomial on every rectangle between its breaks, as compiled loops.
#
# ``polynomials[i, j, l, k]`` is the coefficient of ``(x - x_i)**k (y - y_j)**l`` on piece i along x and piece j along
# y. A value takes a third of the arithmetic that the B-splines take. The polynomials take four to sixteen times as
# much memory.


@vectorised
def fill_polynomials(along_x: Axis, along_y: Axis, coefficients: Array, polynomials: Array) -> None:
    """Fill ``polynomials``, of shape ``(pieces along x, pieces along y, 4, 4)``, from those of the B-splines."""
    cx, cy, c = along_x.cubics, along_y.cubics, coefficients
    rows = np.empty((ORDER, c.shape[1]))
    for i in range(polynomials.shape[0]):
        for k in range(ORDER):
            for n in range(c.shape[1]):
                rows[k, n] = (
                    cx[i, 0, k] * c[i, n]
                    + cx[i, 1, k] * c[i + 1, n]
                    + cx[i, 2, k] * c[i + 2, n]
                    + cx[i, 3, k] * c[i + 3, n]
                )
        for j in range(polynomials.shape[1]):
            for m in range(ORDER):
                for k in range(ORDER):
                    polynomials[i, j, m, k] = (
                        rows[k, j] * cy[j, 0, m]
                        + rows[k, j + 1] * cy[j, 1, m]
                        + rows[k, j + 2] * cy[j, 2, m]
                        + rows[k, j + 3] * cy[j, 3, m]
                    )


@vectorised
def at_patch(q: Array, s: float, t: float) -> tuple[float, float, float]:
    """The polynomial with coefficients ``q`` and its derivatives by s and t, at (s, t) from the begin of its piece."""
    r0 = q[0, 0] + t * (q[1, 0] + t * (q[2, 0] + t * q[3, 0]))
    r1 = q[0, 1] + t * (q[1, 1] + t * (q[2, 1] + t * q[3, 1]))
    r2 = q[0, 2] + t * (q[1, 2] + t * (q[2, 2] + t * q[3, 2]))
    r3 = q[0, 3] + t * (q[1, 3] + t * (q[2, 3] + t * q[3, 3]))
    d0 = q[1, 0] + t * (2.0 * q[2, 0] + t * (3.0 * q[3, 0]))
    d1 = q[1, 1] + t * (2.0 * q[2, 1] + t * (3.0 * q[3, 1]))
    d2 = q[1, 2] + t * (2.0 * q[2, 2] + t * (3.0 * q[3, 2]))
    d3 = q[1, 3] + t * (2.0 * q[2, 3] + t * (3.0 * q[3, 3]))
    return (
        r0 + s * (r1 + s * (r2 + s * r3)),
        r1 + s * (2.0 * r2 + s * (3.0 * r3)),
        d0 + s * (d1 + s * (d2 + s * d3)),
    )


@vectorised
def patch_values(x: Array, y: Array, along_x: Axis, along_y: Axis, polynomials: Array, rows: Array) -> None:
    """Fill the first of ``rows`` with the spline at the points nearest to ``x``, ``y`` within the breaks."""
    first, second = along_x.breaks, along_y.breaks
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        a, b = min(max(x[p], first[0]), first[-1]), min(max(y[p], second[0]), second[-1])
        i, j = piece(a, along_x, scale_x), piece(b, along_y, scale_y)
        s, t = a - first[i], b - second[j]
        q = polynomials[i, j]
        r0 = q[0, 0] + t * (q[1, 0] + t * (q[2, 0] + t * q[3, 0]))
        r1 = q[0, 1] + t * (q[1, 1] + t * (q[2, 1] + t * q[3, 1]))
        r2 = q[0, 2] + t * (q[1, 2] + t * (q[2, 2] + t * q[3, 2]))
        r3 = q[0, 3] + t * (q[1, 3] + t * (q[2, 3] + t * q[3, 3]))
        rows[0, p] = r0 + s * (r1 + s * (r2 + s * r3))


@vectorised
def patch_slopes(x: Array, y: Array, along_x: Axis, along_y: Axis, polynomials: Array, rows: Array) -> None:
    """Fill the first three of ``rows`` with the spline and its first derivatives; see :func:`patch_values`."""
    first, second = along_x.breaks, along_y.breaks
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        a, b = min(max(x[p], first[0]), first[-1]), min(max(y[p], second[0]), second[-1])
        i, j = piece(a, along_x, scale_x), piece(b, along_y, scale_y)
        s, t = a - first[i], b - second[j]
        rows[0, p], rows[1, p], rows[2, p] = at_patch(polynomials[i, j], s, t)


@vectorised
def patch_curvatures(x: Array, y: Array, along_x: Axis, along_y: Axis, polynomials: Array, rows: Array) -> None:
    """Fill the last three of six ``rows`` with the second derivatives; see :func:`patch_values`."""
    first, second = along_x.breaks, along_y.breaks
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    for p in range(x.size):
        a, b = min(max(x[p], first[0]), first[-1]), min(max(y[p], second[0]), second[-1])
        i, j = piece(a, along_x, scale_x), piece(b, along_y, scale_y)
        s, t = a - first[i], b - second[j]
        q = polynomials[i, j]
        r2 = q[0, 2] + t * (q[1, 2] + t * (q[2, 2] + t * q[3, 2]))
        r3 = q[0, 3] + t * (q[1, 3] + t * (q[2, 3] + t * q[3, 3]))
        d1 = q[1, 1] + t * (2.0 * q[2, 1] + t * (3.0 * q[3, 1]))
        d2 = q[1, 2] + t * (2.0 * q[2, 2] + t * (3.0 * q[3, 2]))
        d3 = q[1, 3] + t * (2.0 * q[2, 3] + t * (3.0 * q[3, 3]))
        e0 = 2.0 * q[2, 0] + t * (6.0 * q[3, 0])
        e1 = 2.0 * q[2, 1] + t * (6.0 * q[3, 1])
        e2 = 2.0 * q[2, 2] + t * (6.0 * q[3, 2])
        e3 = 2.0 * q[2, 3] + t * (6.0 * q[3, 3])
        rows[3, p] = 2.0 * r2 + s * (6.0 * r3)
        rows[4, p] = d1 + s * (2.0 * d2 + s * (3.0 * d3))
        rows[5, p] = e0 + s * (e1 + s * (e2 + s * e3))


@vectorised
def slopes_on_mesh(s: Array, t: Array, along_s: Axis, along_t: Axis, of_u: Array, of_map: Pair, rows: Array) -> None:
    """u and its derivatives by x and y, in the three ``rows``, at grid coordinates within the breaks.

    The polynomials are those of u, and of x and y, over the grid coordinates.
    """
    first, second = along_s.breaks, along_t.breaks
    scale_s, scale_t = buckets_per_length(along_s), buckets_per_length(along_t)
    of_x, of_y = of_map
    for p in range(s.size):
        i, j = piece(s[p], along_s, scale_s), piece(t[p], along_t, scale_t)
        a, b = s[p] - first[i], t[p] - second[j]
        u, u_s, u_t = at_patch(of_u[i, j], a, b)
        _, x_s, x_t = at_patch(of_x[i, j], a, b)
        _, y_s, y_t = at_patch(of_y[i, j], a, b)
        per_det = 1.0 / (x_s * y_t - x_t * y_s)
        rows[0, p] = u
        rows[1, p] = (u_s * y_t - u_t * y_s) * per_det
        rows[2, p] = (u_t * x_s - u_s * x_t) * per_det


MAX_PATCHES = 1 << 14
"""Rectangles of the largest spline that is evaluated by a polynomial on each: these take 2 MiB, and stay in a cache."""
OFTEN = 4
"""So many times as many where the spline is evaluated at many more points than it has rectangles."""
COUNT = (1, 3, 6)
"""The number of values up to each order: u; u_x, u_y; u_xx, u_xy, u_yy."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bicubic:
    """A bicubic spline: ``coefficients[i, j]`` of the product of the i-th B-spline in x and the j-th in y.

    ``knots`` are those in x and in y. ``often`` says that it is evaluated at many more points than it has pieces.
    """

    knots: tuple[Array, Array]
    along_x: Axis
    along_y: Axis
    coefficients: Array
    often: bool = False

    @classmethod
    def of(cls, spline: scipy.interpolate.RectBivariateSpline, *, often: bool = False) -> Bicubic:
        """The same spline, which must be cubic in both directions."""
        knots_x, knots_y, coefficients = (np.ascontiguousarray(part, dtype=float) for part in spline.tck)
        return cls(
            knots=(knots_x, knots_y),
            along_x=Axis.between(knots_x),
            along_y=Axis.between(knots_y),
            coefficients=coefficients.reshape(len(knots_x) - ORDER, len(knots_y) - ORDER),
            often=often,
        )

    @property
    def steepest(self) -> tuple[float, float]:
        """Bounds of the derivatives by x and by y: the largest of their coefficients. NaN or infinite if those are."""
        c = self.coefficients
        return _steepest(c, self.knots[0]), _steepest(c.T, self.knots[1])

    def evaluate(self, x: Array, y: Array, order: int = 0) -> tuple[Array, ...]:
        """The spline and its partial derivatives up to ``order``, each of the points' shape; see :data:`COUNT`.

        Outside its rectangle the spline is taken at the nearest point of that; at NaN it is NaN. At the points of
        straight lines, ``x`` and ``y`` that were broadcast from ``(n, 1)`` and ``(1, m)``, it takes half the time.
        """
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if x.shape != y.shape:
            x, y = np.broadcast_arrays(x, y)
        values = np.empty((COUNT[order], *x.shape))
        on_lines = order < 2 and x.ndim == 2 and x.size > 0 and x.strides[1] == y.strides[0] == 0
        if on_lines and self._fill_lines(x[:, 0], y[0], values):
            return tuple(values)
        rows = values.reshape(len(values), -1)
        if math.isfinite(total(x.ravel(), y.ravel())):
            self._fill(x.ravel(), y.ravel(), rows, order)
            return tuple(values)
        nowhere = np.isnan(x) | np.isnan(y)
        x, y = self.along_x.inside(np.where(nowhere, 0.0, x)), self.along_y.inside(np.where(nowhere, 0.0, y))
        self._fill(x.ravel(), y.ravel(), rows, order)
        values[:, nowhere] = np.nan
        return tuple(values)

    def _fill(self, x: Array, y: Array, rows: Array, order: int) -> None:
        patches = self.polynomials
        if patches is not None:
            at = x, y, self.along_x, self.along_y, patches, rows
            patch_values(*at) if order == 0 else patch_slopes(*at)
            if order == 2:
                patch_curvatures(*at)
            return
        at = self.along_x.inside(x), self.along_y.inside(y), self.along_x, self.along_y, self.coefficients, rows
        fill_values(*at) if order == 0 else fill_slopes(*at)
        if order == 2:
            fill_curvatures(*at)

    def _fill_lines(self, x: Array, y: Array, values: Array) -> bool:
        """Fill ``values`` at all points of lines at ``x`` and ``y``; returns whether all of these are finite."""
        is_finite = math.isfinite(x.sum() + y.sum())
        if is_finite:
            x, y = x.copy(), y.copy()  # never read-only, or loops are compiled twice
            fill_lines(x, y, self.along_x, self.along_y, self.coefficients, values)
        return is_finite

    @cached_property
    def polynomials(self) -> Array | None:
        """A polynomial on every rectangle between the breaks; ``None`` where they are too many."""
        pieces = self.along_x.breaks.size - 1, self.along_y.breaks.size - 1
        if pieces[0] * pieces[1] > MAX_PATCHES * (OFTEN if self.often else 1):
            return None
        polynomials = np.empty((*pieces, ORDER, ORDER))
        fill_polynomials(self.along_x, self.along_y, self.coefficients, polynomials)
        return polynomials

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the polynomials, which are computed again where they are needed."""
        return {name: value for name, value in self.__dict__.items() if name != "polynomials"}


def _steepest(coefficients: Array, knots: Array) -> float:
    """The largest coefficient of the derivative along the first axis."""
    with np.errstate(all="ignore"):
        spans = (knots[ORDER:-1] - knots[1:-ORDER]) / (ORDER - 1)
        return float(np.abs(np.diff(coefficients, axis=0) / spans[:, None]).max())


@vectorised
def total(x: Array, y: Array) -> float:
    """The sum of all coordinates: not finite where one of them is not."""
    result = 0.0
    for p in range(x.size):
        result += x[p] + y[p]
    return result


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
def fill_lines(x: Array, y: Array, along_x: Axis, along_y: Axis, coefficients: Array, values: Array) -> None:
    """Fill ``values``, of shape ``(1 or 3, n, m)``, where lines at ``x`` cross lines at ``y``.

    Outside the breaks they are those of the nearest lines. Three are the spline and its first derivatives. What it is
    along a line is computed once for all points of that.
    """
    scale_x, scale_y = buckets_per_length(along_x), buckets_per_length(along_y)
    places, basis, slopes = np.empty(y.size, np.int64), np.empty((ORDER, y.size)), np.empty((ORDER, y.size))
    for q in range(y.size):
        t = min(max(y[q], along_y.breaks[0]), along_y.breaks[-1])
        j = piece(t, along_y, scale_y)
        t -= along_y.breaks[j]
        places[q] = j
        basis[0, q], basis[1, q], basis[2, q], basis[3, q] = at_piece(along_y.cubics, j, t)
        slopes[0, q], slopes[1, q], slopes[2, q], slopes[3, q] = slopes_at_piece(along_y.cubics, j, t)
    line, across = np.empty(coefficients.shape[1]), np.empty(coefficients.shape[1])
    for p in range(x.size):
        s = min(max(x[p], along_x.breaks[0]), along_x.breaks[-1])
        i = piece(s, along_x, scale_x)
        s -= along_x.breaks[i]
        a, b, c, d = at_piece(along_x.cubics, i, s)
        e, f, g, h = slopes_at_piece(along_x.cubics, i, s)
        c0, c1, c2, c3 = coefficients[i], coefficients[i + 1], coefficients[i + 2], coefficients[i + 3]
        for n in range(line.size):
            line[n] = a * c0[n] + b * c1[n] + c * c2[n] + d * c3[n]
            across[n] = e * c0[n] + f * c1[n] + g * c2[n] + h * c3[n]
        u = values[0, p]
        for q in range(y.size):
            j = places[q]
            v0, v1, v2, v3 = line[j], line[j + 1], line[j + 2], line[j + 3]
            u[q] = basis[0, q] * v0 + basis[1, q] * v1 + basis[2, q] * v2 + basis[3, q] * v3
        if values.shape[0] == 1:
            continue
        u_x, u_y = values[1, p], values[2, p]
        for q in range(y.size):
            j = places[q]
            v0, v1, v2, v3 = line[j], line[j + 1], line[j + 2], line[j + 3]
            w0, w1, w2, w3 = across[j], across[j + 1], across[j + 2], across[j + 3]
            u_x[q] = basis[0, q] * w0 + basis[1, q] * w1 + basis[2, q] * w2 + basis[3, q] * w3
            u_y[q] = slopes[0, q] * v0 + slopes[1, q] * v1 + slopes[2, q] * v2 + slopes[3, q] * v3


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
