"""A bicubic spline and its partial derivatives at scattered points, as compiled loops.

FITPACK computes the spline; this module evaluates it. FITPACK recomputes the B-splines for each value at each point,
which takes a microsecond. On a piece of an axis only four are not zero, and these are cubics: their coefficients are
computed once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline

from equimesh.fields.axis import ORDER, Axis, at_piece, buckets_per_length, piece, slopes_at_piece
from equimesh.fields.patches import fill_polynomials, patch_curvatures, patch_slopes, patch_values
from equimesh.numerics.compiled import vectorised
from equimesh.numerics.types import Array

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
    def of(cls, spline: RectBivariateSpline, *, often: bool = False) -> Bicubic:
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

        Outside its rectangle the spline is taken at the nearest point of that; at NaN it is NaN.
        """
        x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if x.shape != y.shape:
            x, y = np.broadcast_arrays(x, y)
        values = np.empty((COUNT[order], *x.shape))
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
