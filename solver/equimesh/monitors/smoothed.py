"""A smoothed metric: the entries of another one, averaged with a Gaussian."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy

from equimesh.domains.domain import Box, Domain, Periods, periods_of
from equimesh.errors import InputError
from equimesh.fields.periodic import within
from equimesh.inputs import keep_floats
from equimesh.monitors.monitor import (
    Matrices,
    Monitor,
    OfMonitor,
    Probe,
    bound_copy,
    is_bound_to,
    weaken,
)
from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, BoolArray, Pair
from equimesh_schema.document import is_number

MAX_RADIUS = 0.25  # in units of the shorter extent of the box
SAMPLES = 512  # of the monitor, in a direction of the reference square
POINTS_PER_RADIUS = 8  # of the table, as far as the numbers below allow
MIN_TABLE_POINTS = 64  # along the shorter extent of the box
MAX_TABLE_POINTS = 512  # along the shorter extent of the box
MAX_LONG_TABLE_POINTS = 2048  # along the longer extent of the box
MARGIN_POINTS = 3  # table points beyond the box: the spline reaches two of them
REACH = 6.0  # of the Gaussian, in radii: what lies further away has no weight
MAX_TURNS = 2  # periods beyond a seam within its reach
OWN_VARIANCE = 1 / 6 + 1 / 3  # of the table's hat functions and of the cubic B-spline, in squared spacings


class Lattice(NamedTuple):
    """The position of the points of a table: the first point, and the number of points per unit of length."""

    x0: float
    y0: float
    per_length: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Table:
    """Metrics on a uniform grid over a box, read off as cubic B-splines with these coefficients.

    ``entries[i, j]`` holds ``(m11, m12, m22)`` at ``(x0 + i spacing, y0 + j spacing)``. The value at a point is a
    convex combination of the 16 nearest metrics, positive definite as they are, and has two continuous derivatives.
    """

    entries: Array
    origin: tuple[float, float]
    spacing: float

    def at(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """The metrics at points of any shape; outside the table those of its rim."""
        x, y = (np.asarray(q, dtype=np.float64, order="C") for q in (x, y))
        out = np.empty((3, x.size))
        _look_up(self.entries, Lattice(*self.origin, 1.0 / self.spacing), x.reshape(-1), y.reshape(-1), out)
        return out[0].reshape(x.shape), out[1].reshape(x.shape), out[2].reshape(x.shape)


@dataclass(frozen=True, kw_only=True)
class Smoothed(OfMonitor):
    """The metric of ``monitor``, each entry averaged with a Gaussian over its physical neighbourhood in the domain.

    ``radius`` is the standard deviation of the Gaussian in units of the shorter extent of the domain's box, in
    (0, 0.25]; a smaller one than about 1/700 acts as 1/700. Steep fronts of the metric become at least as wide as the
    radius: raise it when a solve fails. A mean of positive definite matrices is positive definite, and a constant
    metric does not change.

    The mean is over the points of the domain only, with the weights of the part of the Gaussian that lies inside.
    :meth:`on` samples the monitor at 512 x 512 points; the metric is then read from a table over the domain's box.
    Distances are straight lines: if a bent domain has a slit narrower than the radius, values are averaged across it.

    A :class:`~equimesh.monitors.monitor.Monitor`. Raises :class:`~equimesh.errors.InputError` for a radius outside its
    range.
    """

    radius: float = 0.05
    _domain: Domain | None = field(default=None, init=False, repr=False, compare=False)
    _table: Table | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        keep_floats(self, "radius")
        if not (is_number(self.radius) and 0.0 < self.radius <= MAX_RADIUS):
            raise InputError(
                f"radius = {self.radius!r:.40}: the radius of smoothing is positive and at most {MAX_RADIUS:g} of the"
                " domain's shorter extent; leave the smoothing out for none",
                field="radius",
            )

    def metric(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """``(m11, m12, m22)`` at physical points, from the table.

        Raises :class:`~equimesh.errors.InputError` before the monitor is bound to a domain.
        """
        if self._table is None:
            raise InputError("a smoothed monitor is an average over a domain: call monitor.on(domain) first")
        return self._table.at(*(within(self._domain, x, y) if self._domain is not None else (x, y)))

    def on(self, domain: Domain) -> Smoothed:
        """The monitor bound to ``domain``, with the table of its averages there.

        Raises :class:`~equimesh.errors.InputError` where the metric of ``monitor`` is not finite.
        """
        if is_bound_to(self._domain, domain):
            return self
        inner = self.monitor.on(domain)
        return bound_copy(self, domain, monitor=inner, _table=_averages(inner, domain, self.radius))

    def weakened(self, strength: float) -> Monitor:
        """The smoothed metric to the matrix power ``strength``."""
        return weaken(self, strength)


def _averages(monitor: Monitor, domain: Domain, radius: float) -> Table:
    """The averages on a grid: samples weighted by area, spread, filtered, and divided by the filtered weights."""
    (x0, x1), (y0, y1) = box = domain.box
    short, long = sorted((x1 - x0, y1 - y0))
    if any(map(any, periods_of(domain))):  # what lies beyond a seam counts, too
        (x0, x1), (y0, y1) = _beyond_seams(box, periods_of(domain), REACH * radius * short)
        long = max(x1 - x0, y1 - y0)
    spacing = max(
        short / min(max(math.ceil(POINTS_PER_RADIUS / radius), MIN_TABLE_POINTS), MAX_TABLE_POINTS),
        long / MAX_LONG_TABLE_POINTS,
    )
    origin = (x0 - MARGIN_POINTS * spacing, y0 - MARGIN_POINTS * spacing)
    shape = tuple(math.ceil(extent / spacing) + 2 * MARGIN_POINTS + 1 for extent in (x1 - x0, y1 - y0))
    probe = Probe.of(domain, SAMPLES)
    m11, m12, m22 = monitor.metric(probe.x, probe.y)
    probe.require_finite((m11, m12, m22), "the metric is", field="smoothing")
    sums, lattice = np.zeros((4, *shape)), Lattice(*origin, 1.0 / spacing)
    for x, y, found in _copies(probe, periods_of(domain), ((x0, x1), (y0, y1))):
        _spread((x, y), probe.shares[found], (m11[found], m12[found], m22[found]), lattice, sums)
    deviation = math.sqrt(max((radius * short / spacing) ** 2 - OWN_VARIANCE, 0.0))
    if deviation > 0.0:
        for layer in sums:
            scipy.ndimage.gaussian_filter(layer, deviation, output=layer, mode="constant", truncate=REACH)
    weights = sums[3]
    known = weights > 1e-9 * weights.max()
    entries = np.moveaxis(sums[:3], 0, -1) / np.where(known, weights, 1.0)[..., None]
    if not known.all():
        nearest = scipy.ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
        entries = entries[tuple(nearest)]
    return Table(entries=np.ascontiguousarray(entries), origin=origin, spacing=spacing)


def _beyond_seams(box: Box, periods: Periods, reach: float) -> Box:
    """The box, and so much beyond its sides that are seams."""
    (x0, x1), (y0, y1) = box
    along_x, along_y = (reach * any(period) for period in periods)
    return (x0 - along_x, x1 + along_x), (y0 - along_y, y1 + along_y)


def _copies(probe: Probe, periods: Periods, box: Box) -> Iterator[tuple[Array, Array, BoolArray]]:
    """The samples in a box, and which of the probe's they are: its own, and their copies by whole periods."""
    (x0, x1), (y0, y1) = box
    turns = [range(-MAX_TURNS, MAX_TURNS + 1) if any(period) else range(1) for period in periods]
    for i in turns[0]:
        for j in turns[1]:
            x = probe.x + (i * periods[0][0] + j * periods[1][0])
            y = probe.y + (i * periods[0][1] + j * periods[1][1])
            found = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
            if found.any():
                yield x[found], y[found], found


@compiled
def _spread(points: Pair, weights: Array, metric: Matrices, lattice: Lattice, sums: Array) -> None:
    """The weighted metrics, and the weights, distributed over the four table points around each sample."""
    (x, y), (m11, m12, m22) = points, metric
    x0, y0, per_length = lattice
    for k in range(x.size):
        p, q = (x[k] - x0) * per_length, (y[k] - y0) * per_length
        i, j = min(max(int(p), 0), sums.shape[1] - 2), min(max(int(q), 0), sums.shape[2] - 2)
        p, q = min(max(p - i, 0.0), 1.0), min(max(q - j, 0.0), 1.0)
        for a in range(2):
            for b in range(2):
                w = weights[k] * (p if a else 1.0 - p) * (q if b else 1.0 - q)
                sums[0, i + a, j + b] += w * m11[k]
                sums[1, i + a, j + b] += w * m12[k]
                sums[2, i + a, j + b] += w * m22[k]
                sums[3, i + a, j + b] += w


@compiled
def _look_up(entries: Array, lattice: Lattice, x: Array, y: Array, out: Array) -> None:
    """Uniform cubic B-splines: the weights of the four nearest table points in each direction."""
    x0, y0, per_length = lattice
    n, m = entries.shape[0], entries.shape[1]
    for k in range(x.size):
        if x[k] - x[k] != 0.0 or y[k] - y[k] != 0.0:  # NaN or infinite: not in the table
            out[0, k] = out[1, k] = out[2, k] = np.nan
            continue
        p, q = min(max((x[k] - x0) * per_length, 1.0), n - 2.0), min(max((y[k] - y0) * per_length, 1.0), m - 2.0)
        i, j = min(int(p), n - 3), min(int(q), m - 3)
        p, q = p - i, q - j
        r, s = 1.0 - p, 1.0 - q
        w0, w3 = s * s * s / 6.0, q * q * q / 6.0
        w1 = 2.0 / 3.0 - q * q * (1.0 - 0.5 * q)
        w2 = 1.0 - w0 - w1 - w3
        v0, v3 = r * r * r / 6.0, p * p * p / 6.0
        v1 = 2.0 / 3.0 - p * p * (1.0 - 0.5 * p)
        v2 = 1.0 - v0 - v1 - v3
        m11, m12, m22 = 0.0, 0.0, 0.0
        for a in range(4):
            v = v0 if a == 0 else v1 if a == 1 else v2 if a == 2 else v3
            row = entries[i - 1 + a]
            m11 += v * (w0 * row[j - 1, 0] + w1 * row[j, 0] + w2 * row[j + 1, 0] + w3 * row[j + 2, 0])
            m12 += v * (w0 * row[j - 1, 1] + w1 * row[j, 1] + w2 * row[j + 1, 1] + w3 * row[j + 2, 1])
            m22 += v * (w0 * row[j - 1, 2] + w1 * row[j, 2] + w2 * row[j + 1, 2] + w3 * row[j + 2, 2])
        out[0, k], out[1, k], out[2, k] = m11, m12, m22
