"""Guarded Newton iteration on vectors. Knows nothing of meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias, TypeVar

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

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


def superlu(matrix: csc_array) -> Solver:
    """SuperLU with its default ordering; raises ``RuntimeError`` for a matrix that is singular or not finite."""
    require_finite(matrix)
    factors = splu(matrix)
    return lambda right: np.asarray(factors.solve(right))


def require_finite(matrix: csc_array) -> None:
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


def factorise(matrix: csc_array, shape: tuple[int, int]) -> Callable[[Array], Array]:
    """A function that solves systems with ``matrix``, whose unknowns are x, then y, of the nodes of a grid.

    The nodes are eliminated by nested dissection: less work than in an order that ignores the grid. Raises
    ``RuntimeError`` for a matrix that is singular or not finite.
    """
    require_finite(matrix)
    order = elimination_order(shape)
    turned = csc_array(matrix[order][:, order])
    factors = splu(turned, permc_spec="NATURAL", diag_pivot_thresh=MIN_PIVOT_SHARE, options={"SymmetricMode": True})

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
