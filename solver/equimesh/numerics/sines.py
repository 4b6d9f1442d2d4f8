"""A fast solver of an elliptic equation on a grid: sines along one direction, tridiagonal systems along the other."""

from functools import lru_cache

import numpy as np
from scipy.fft import dst, idst

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array


def solve_by_sines(along: float, across: Array, right: Array) -> Array:
    """The solution p of ``along D0 p + across[i] D1 p = right``, zero beyond the array.

    ``D0`` and ``D1`` are the second differences ``p[i - 1] - 2 p[i] + p[i + 1]`` along the two directions. ``across``
    has an entry for each row of ``right``. The cost is that of two sine transforms. ``along`` is positive and
    ``across`` not negative.
    """
    waves = np.ascontiguousarray(dst(right, type=1, axis=1))
    _solve_tridiagonal(along, across, _eigenvalues(right.shape[1]), waves)
    return np.asarray(idst(waves, type=1, axis=1))


def solve_lines(along: float, right: Array) -> Array:
    """As :func:`solve_by_sines` without the second term: every line along the first direction by itself."""
    found, nothing = np.array(right, order="C"), np.zeros(right.shape[1])
    nothing.setflags(write=False)  # as the eigenvalues: for others the loop would be compiled once more
    _solve_tridiagonal(along, np.zeros(right.shape[0]), nothing, found)
    return found


@lru_cache(maxsize=32)
def _eigenvalues(size: int) -> Array:
    """The eigenvalues of the negative second difference of ``size`` values that are zero beyond their ends."""
    values = 4.0 * np.sin(np.pi * np.arange(1, size + 1) / (2 * (size + 1))) ** 2
    values.setflags(write=False)
    return np.asarray(values)


@compiled
def _solve_tridiagonal(along: float, across: Array, eigenvalues: Array, right: Array) -> None:
    """For every column k: ``along D0 p - across eigenvalues[k] p = right``, in place."""
    rows, columns = right.shape
    upper = np.empty((rows, columns))
    for k in range(columns):
        pivot = -2.0 * along - across[0] * eigenvalues[k]
        upper[0, k] = along / pivot
        right[0, k] /= pivot
    for i in range(1, rows):
        for k in range(columns):
            pivot = -2.0 * along - across[i] * eigenvalues[k] - along * upper[i - 1, k]
            upper[i, k] = along / pivot
            right[i, k] = (right[i, k] - along * right[i - 1, k]) / pivot
    for i in range(rows - 2, -1, -1):
        for k in range(columns):
            right[i, k] -= upper[i, k] * right[i + 1, k]
