"""GMRES: a linear system whose matrix is known by its products only."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

Linear: TypeAlias = Callable[[Array], Array]


def gmres(apply: Linear, precondition: Linear, right: Array, *, tolerance: float, most: int) -> Array:
    """An approximate solution of ``apply(v) = right``, after at most ``most`` products.

    It minimises the Euclidean norm of the residual over the Krylov space of ``apply(precondition(.))``, and ends where
    the residual is ``tolerance`` times that of zero. Saad and Schultz 1986, with the preconditioner on the right. All
    sums are compiled loops: results do not depend on the number of threads of a library.
    """
    size = math.sqrt(dot(right, right))
    if not 0.0 < size < math.inf:
        return np.zeros_like(right)
    basis, triangle = [right / size], np.zeros((most, most))
    turns, rest = np.zeros((most, 2)), np.zeros(most + 1)
    rest[0] = size
    used = 0
    for k in range(most):
        product = apply(precondition(basis[k]))
        if not math.isfinite(dot(product, product)):
            break
        column = np.array([_removed(product, old) for old in basis])
        length = math.sqrt(dot(product, product))
        for i in range(k):  # the rotations that made the earlier columns triangular
            c, s = turns[i]
            column[i], column[i + 1] = c * column[i] + s * column[i + 1], c * column[i + 1] - s * column[i]
        whole = math.hypot(column[k], length)
        if whole == 0.0:
            break
        turns[k] = column[k] / whole, length / whole
        column[k] = whole
        triangle[: k + 1, k] = column
        rest[k], rest[k + 1] = turns[k, 0] * rest[k], -turns[k, 1] * rest[k]
        used = k + 1
        if abs(rest[used]) <= tolerance * size or length == 0.0:
            break
        basis.append(product / length)
    weights = _back_substituted(triangle[:used, :used], rest[:used])
    combined = np.zeros_like(right)
    for weight, vector in zip(weights, basis, strict=False):
        combined += weight * vector
    return precondition(combined)


def _removed(product: Array, old: Array) -> float:
    """The component of ``product`` along ``old``, which is subtracted in place."""
    component = dot(product, old)
    product -= component * old
    return component


def _back_substituted(triangle: Array, right: Array) -> Array:
    weights = right.copy()
    for i in range(right.size - 1, -1, -1):
        weights[i] = (weights[i] - sum(triangle[i, j] * weights[j] for j in range(i + 1, right.size))) / triangle[i, i]
    return weights


@compiled
def dot(first: Array, second: Array) -> float:
    """The inner product of two vectors, in four sums that are added at the end."""
    a = b = c = d = 0.0
    whole = first.size - first.size % 4
    for k in range(0, whole, 4):
        a += first[k] * second[k]
        b += first[k + 1] * second[k + 1]
        c += first[k + 2] * second[k + 2]
        d += first[k + 3] * second[k + 3]
    for k in range(whole, first.size):
        a += first[k] * second[k]
    return (a + b) + (c + d)
