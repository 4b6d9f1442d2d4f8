"""The noise of samples: the part that changes from sample to sample without any relation to its neighbours."""

from __future__ import annotations

import math

import numpy as np
import scipy

from equimesh.fields.chunked_samples import ChunkedSamples
from equimesh.fields.expression import Field
from equimesh.fields.nodal_field import HermiteField, NodalField
from equimesh.fields.on_domain import OnDomain
from equimesh.fields.samples import GridSamples
from equimesh.fields.scattered_samples import ScatteredSamples
from equimesh.numerics.types import Array

MEDIAN_OF_NORMAL = 0.6745
"""The median of the size of a normal variable over its standard deviation."""
SECOND = 2
"""The order of a difference that is 0 for linear functions."""
FOURTH = 4
"""The order of a difference that is 0 for cubic functions."""
MIN_AXIS_SAMPLES = 9
"""Samples along an axis; from fewer the noise cannot be told from u."""
MAX_AXIS_SAMPLES = 257
"""Samples along an axis that are looked at."""
MIN_WHITE_SHARE = 0.5
"""Both differences see the same noise. They see a smooth u by very different amounts."""
NEIGHBOURS = 12
"""Scattered samples near one of them, to which a polynomial is fitted."""
MAX_FITTED_SAMPLES = 1_000
"""Scattered samples at which it is fitted."""


def noise_share(field: Field | None) -> float:
    """The standard deviation of the noise in the samples of ``field`` over their range; 0 where none is seen.

    Second and fourth differences of samples on a grid, or linear and quadratic fits of scattered ones, are compared.
    Noise gives the same estimate by both. Where the estimates differ by more than a factor of two, what is seen is u.
    The median over all samples leaves out fronts. Functions that are not samples have no noise.
    """
    if isinstance(field, OnDomain):
        return noise_share(field.reference)
    if isinstance(field, GridSamples | NodalField | HermiteField):
        middle = field.values[_middle(field.values.shape)]
        return _share(_range(field.values), *(_of_differences(middle, order) for order in (SECOND, FOURTH)))
    if isinstance(field, ChunkedSamples):
        middle = field.read(*_middle(field.shape))
        return _share(field.found.size, *(_of_differences(middle, order) for order in (SECOND, FOURTH)))
    if isinstance(field, ScatteredSamples):
        return _share(_range(field.values), *_of_fits(field.points, field.values))
    return 0.0


def _range(values: Array) -> float:
    return float(np.ptp(values))


def _share(size: float, low: float, high: float) -> float:
    return high / size if size > 0.0 and high > MIN_WHITE_SHARE * low else 0.0


def _middle(shape: tuple[int, ...]) -> tuple[slice, ...]:
    """Where the samples in the middle are, at most ``MAX_AXIS_SAMPLES`` along an axis: enough for a median."""
    firsts = [max(0, (count - MAX_AXIS_SAMPLES) // 2) for count in shape]
    return tuple(slice(first, min(first + MAX_AXIS_SAMPLES, n)) for first, n in zip(firsts, shape, strict=True))


def _of_differences(values: Array, order: int) -> float:
    """The noise by the product of a difference in both directions, whose size it scales with the sum of squares.

    That is the sum of the squares of the binomial coefficients, in both directions together.
    """
    if min(values.shape) < MIN_AXIS_SAMPLES:
        return 0.0
    differences = np.diff(np.diff(values, order, axis=0), order, axis=1)
    return _median(np.abs(differences).ravel()) / (MEDIAN_OF_NORMAL * math.comb(2 * order, order))


def _median(sizes: Array) -> float:
    """The median, as ``np.median`` gives it, in a third of the time that it takes for few finite numbers."""
    middle = sizes.size // 2
    parted = np.partition(sizes, middle)
    return float(parted[middle]) if sizes.size % 2 else 0.5 * float(parted[:middle].max() + parted[middle])


def _of_fits(points: Array, values: Array) -> tuple[float, float]:
    """The noise by what linear and quadratic fits leave of the nearest samples."""
    if len(points) < MIN_AXIS_SAMPLES**2:
        return 0.0, 0.0
    chosen = np.linspace(0, len(points) - 1, min(len(points), MAX_FITTED_SAMPLES)).astype(np.int64)
    _, near = scipy.spatial.cKDTree(points).query(points[chosen], k=NEIGHBOURS)
    x, y = np.moveaxis(points[near] - points[chosen][:, None, :], -1, 0)
    scale = np.maximum(np.hypot(x, y).max(axis=1, keepdims=True), np.finfo(np.float64).tiny)
    x, y = x / scale, y / scale
    terms = [np.ones_like(x), x, y, x * x, x * y, y * y]
    return _left_of_fit(terms[:3], values[near]), _left_of_fit(terms, values[near])


def _left_of_fit(terms: list[Array], values: Array) -> float:
    basis, _ = np.linalg.qr(np.stack(terms, axis=-1))
    rest = values - np.einsum("pik,pjk,pj->pi", basis, basis, values)
    squares = np.sum(rest**2, axis=1) / (NEIGHBOURS - len(terms))
    return math.sqrt(float(np.median(squares)))
