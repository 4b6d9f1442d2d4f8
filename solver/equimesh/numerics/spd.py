"""Symmetric 2 x 2 matrices at many points, in closed form: power, intersection, eigenvalues.

A matrix field is a triple ``(m11, m12, m22)`` of arrays of one shape; so is every result that is one. Nothing is
checked and nothing is raised: where a matrix is not what the function needs, the result is nan or meaningless.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

Matrices: TypeAlias = tuple[Array, Array, Array]

CORNER_WIDTH = 1e-4
"""Width of the rounded corner of the maximum in :func:`intersection`, squared, relative to the metrics."""


def eigenvalues(matrices: Matrices) -> tuple[Array, Array]:
    """The smaller and the larger eigenvalue."""
    m11, m12, m22 = matrices
    mean, radius = 0.5 * (m11 + m22), np.hypot(0.5 * (m11 - m22), m12)
    return mean - radius, mean + radius


def power(matrices: Matrices, exponent: float) -> Matrices:
    """The positive definite matrices to a real power: the same eigenvectors, the eigenvalues to that power."""
    return _each(_power, matrices, float(exponent))


def intersection(first: Matrices, second: Matrices) -> Matrices:
    """The metric of two by simultaneous reduction: ``v^T M v`` is at least that of either for every v.

    The intersection of metrics of P. J. Frey and F. Alauzet (Comput. Methods Appl. Mech. Engrg. 194, 2005). In the
    basis in which both are diagonal, with the first the identity and the second mu, it is
    ``max(1, mu)``, rounded upwards near mu = 1 (by half a percent at 1) so that it depends smoothly on both.
    It has the form ``c1 first + c2 second``: no eigenvectors are computed. The order does not matter.
    """
    out = np.empty((3, np.size(first[0])))
    _intersection(_flat(first), _flat(second), CORNER_WIDTH, out)
    return _split(out, np.shape(first[0]))


def _flat(matrices: Matrices) -> Matrices:
    m11, m12, m22 = (np.ascontiguousarray(entry, dtype=np.float64).reshape(-1) for entry in matrices)
    return m11, m12, m22


def _each(kernel: Callable[..., None], matrices: Matrices, number: float) -> Matrices:
    m11, m12, m22 = (np.asarray(entry, dtype=np.float64, order="C") for entry in matrices)
    out = np.empty((3, m11.size))
    kernel(m11.reshape(-1), m12.reshape(-1), m22.reshape(-1), number, out)
    return _split(out, m11.shape)


def _split(out: Array, shape: tuple[int, ...]) -> Matrices:
    return out[0].reshape(shape), out[1].reshape(shape), out[2].reshape(shape)


@compiled
def _power(m11: Array, m12: Array, m22: Array, exponent: float, out: Array) -> None:
    """With eigenvalues ``g exp(+-r)`` the power is ``g^p (cosh(p r) I + sinh(p r) / sinh(r) (M/g - cosh(r) I))``."""
    for i in range(m11.size):
        mean, half = 0.5 * (m11[i] + m22[i]), 0.5 * (m11[i] - m22[i])
        radius = np.sqrt(half * half + m12[i] * m12[i])
        root = np.sqrt(m11[i] * m22[i] - m12[i] * m12[i])
        stretch = (mean + radius) / root
        if stretch > 1.0 + 1e-8:
            one = stretch**exponent
            other = 1.0 / one
            ratio = (one - other) / (stretch - 1.0 / stretch)
        else:
            one = other = 1.0
            ratio = exponent
        if not root > 0.0:
            ratio = np.nan
        size = root**exponent
        centre, scale = size * 0.5 * (one + other), size * ratio / root
        out[0, i] = centre + scale * half
        out[1, i] = scale * m12[i]
        out[2, i] = centre - scale * half


@compiled
def _intersection(first: Matrices, second: Matrices, rounding: float, out: Array) -> None:
    """``c1 M + c2 N`` with ``c1 + c2 mu = (1 + mu + s(mu)) / 2``, ``s = sqrt((mu - 1)^2 + rounding mu)``.

    mu are the eigenvalues of ``M^-1 N``; only their sum t and product d are needed, and the two s come in as their
    product and their sum.
    """
    (m11, m12, m22), (n11, n12, n22) = first, second
    for i in range(m11.size):
        det = m11[i] * m22[i] - m12[i] * m12[i]
        t = (m22[i] * n11[i] - 2.0 * m12[i] * n12[i] + m11[i] * n22[i]) / det
        d = (n11[i] * n22[i] - n12[i] * n12[i]) / det
        gap = d - t + 1.0
        mixed = max((d + 1.0) * t - 4.0 * d, 0.0)
        product = np.sqrt(gap * gap + rounding * (mixed + rounding * d))
        total = np.sqrt(max((t - 1.0) ** 2 + 1.0 - 2.0 * d, 0.0) + rounding * t + 2.0 * product)
        c1 = 0.5 * (1.0 + (1.0 - d + product) / total)
        c2 = 0.5 * (1.0 + (t - 2.0 + rounding) / total)
        out[0, i] = c1 * m11[i] + c2 * n11[i]
        out[1, i] = c1 * m12[i] + c2 * n12[i]
        out[2, i] = c1 * m22[i] + c2 * n22[i]
