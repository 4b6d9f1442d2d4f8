"""Solvers of systems of equations: guarded Newton steps, GMRES, sparse factors, and a fast solver by sines."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias, TypeVar

import numpy as np
import scipy

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array, IntArray

Solver: TypeAlias = Callable[[Array], Array]
M = TypeVar("M")

# A step is not damped below this share.
MIN_DAMPING = 2.0**-12
# A damped step must reduce the norm of the residual at least by this share of the damping.
MIN_DECREASE_SHARE = 1e-4
# A factorisation is used again after a full step that lowered the residual at least by this factor.
MAX_REUSE_FACTOR = 0.25


@dataclass(frozen=True, kw_only=True)
class NewtonStep:
    """The state after ``step`` Newton steps; step 0 is the start.

    ``residual`` is the max norm of F, ``damping`` the accepted fraction of the last Newton correction.
    ``stalled`` is set where no admissible fraction of the next correction lowers the residual.
    """

    step: int
    z: Array
    residual: float
    damping: float
    stalled: bool = False


def superlu(matrix: scipy.sparse.csc_array) -> Solver:
    """SuperLU with its default ordering; raises ``RuntimeError`` for a matrix that is singular or not finite."""
    require_finite(matrix)
    factors = scipy.sparse.linalg.splu(matrix)
    return lambda right: np.asarray(factors.solve(right))


def require_finite(matrix: scipy.sparse.csc_array) -> None:
    """Raise ``RuntimeError`` for a matrix with an entry that is not finite."""
    if not np.isfinite(matrix.data).all():
        raise RuntimeError("the matrix is not finite")


def newton_iterations(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], M],
    start: Array,
    *,
    admissible: Callable[[Array], bool],
    tolerance: float,
    factorise: Callable[[M], Solver],
    reuse: bool = False,
) -> Iterator[NewtonStep]:
    """Newton steps for ``residual(z) = 0`` from ``start``, until the tolerance is met or the search stalls.

    A step is halved until it **both** lowers the Euclidean norm of the residual and is ``admissible``: without the
    second condition Newton's method converges to folded meshes. The caller owns the loop, and with it the limit on the
    number of steps. ``factorise`` gives a solver of the linear systems with what ``jacobian`` returns, and raises
    ``RuntimeError`` where there is none. With ``reuse`` a factorisation is kept for as long as full steps with it lower
    the residual well.
    The last record has ``residual <= tolerance`` or ``stalled``.
    """
    z, value, damping, step = start, residual(start), 1.0, 0
    solve: Solver | None = None
    while True:
        norm, largest = float(np.linalg.norm(value)), float(np.max(np.abs(value)))
        if largest <= tolerance:
            yield NewtonStep(step=step, z=z, residual=largest, damping=damping)
            return
        accepted = None
        if solve is not None:  # no search: after a step that is not good, a new factorisation is made
            accepted = _search(residual, admissible, z, norm, solve(-value), smallest=1.0)
            solve = solve if accepted is not None and _is_good(accepted, norm) else None
        if accepted is None:
            solve = _try_factorise(factorise, jacobian(z))
            if solve is not None:
                accepted = _search(residual, admissible, z, norm, solve(-value))
            solve = solve if reuse and accepted is not None and _is_good(accepted, norm) else None
        yield NewtonStep(step=step, z=z, residual=largest, damping=damping, stalled=accepted is None)
        if accepted is None:
            return
        z, value, damping = accepted
        step += 1


def _try_factorise(factorise: Callable[[M], Solver], matrix: M) -> Solver | None:
    try:
        return factorise(matrix)
    except RuntimeError:  # the matrix is singular or not finite
        return None


def _is_good(accepted: tuple[Array, Array, float], norm: float) -> bool:
    return accepted[2] == 1.0 and float(np.linalg.norm(accepted[1])) <= MAX_REUSE_FACTOR * norm


def _search(
    residual: Callable[[Array], Array],
    admissible: Callable[[Array], bool],
    z: Array,
    norm: float,
    correction: Array,
    smallest: float = MIN_DAMPING,
) -> tuple[Array, Array, float] | None:
    damping = 1.0
    while damping >= smallest:
        candidate = z + damping * correction
        if admissible(candidate):
            value = residual(candidate)
            if np.linalg.norm(value) <= (1.0 - MIN_DECREASE_SHARE * damping) * norm:
                return candidate, value, damping
        damping /= 2
    return None


# Sparse factorisation of the equations of a grid, in an order that keeps the factors sparse.

# Blocks of at most this many nodes are not cut any further.
MAX_BLOCK_NODES = 16
# The smallest pivot on the diagonal, as a share of the largest entry of its column.
MIN_PIVOT_SHARE = 0.01


def factorise(matrix: scipy.sparse.csc_array, shape: tuple[int, int]) -> Callable[[Array], Array]:
    """A function that solves systems with ``matrix``, whose unknowns are x, then y, of the nodes of a grid.

    The nodes are eliminated by nested dissection: less work than in an order that ignores the grid. Raises
    ``RuntimeError`` for a matrix that is singular or not finite.
    """
    require_finite(matrix)
    order = elimination_order(shape)
    turned = scipy.sparse.csc_array(matrix[order][:, order])
    factors = scipy.sparse.linalg.splu(
        turned, permc_spec="NATURAL", diag_pivot_thresh=MIN_PIVOT_SHARE, options={"SymmetricMode": True}
    )

    def solve(right: Array) -> Array:
        solution = np.empty_like(right)
        solution[order] = factors.solve(right[order])
        return solution

    return solve


@lru_cache(maxsize=16)
def elimination_order(shape: tuple[int, int]) -> IntArray:
    """The unknowns of a grid in nested dissection order, the two of a node next to each other."""
    nodes = np.concatenate(_dissect(np.arange(shape[0] * shape[1]).reshape(shape)))
    order = np.column_stack([nodes, nodes + shape[0] * shape[1]]).ravel()
    order.setflags(write=False)
    return order


def _dissect(block: IntArray) -> list[IntArray]:
    """The two halves of a block of nodes, then the line that parts them."""
    if block.size <= MAX_BLOCK_NODES:
        return [block.ravel()]
    if block.shape[0] < block.shape[1]:
        block = block.T
    middle = block.shape[0] // 2
    return [*_dissect(block[:middle]), *_dissect(block[middle + 1 :]), block[middle]]


# GMRES: a linear system whose matrix is known by its products only.

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


# A fast solver of an elliptic equation on a grid: sines along one direction, tridiagonal systems along the other.


def solve_by_sines(along: float, across: Array, right: Array) -> Array:
    """The solution p of ``along D0 p + across[i] D1 p = right``, zero beyond the array.

    ``D0`` and ``D1`` are the second differences ``p[i - 1] - 2 p[i] + p[i + 1]`` along the two directions. ``across``
    has an entry for each row of ``right``. The cost is that of two sine transforms. ``along`` is positive and
    ``across`` not negative.
    """
    waves = np.ascontiguousarray(scipy.fft.dst(right, type=1, axis=1))
    _solve_tridiagonal(along, across, _eigenvalues(right.shape[1]), waves)
    return np.asarray(scipy.fft.idst(waves, type=1, axis=1))


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
