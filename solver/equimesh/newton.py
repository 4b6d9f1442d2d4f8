"""Guarded Newton iteration on vectors. Knows nothing of meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

Array: TypeAlias = npt.NDArray[np.float64]

SMALLEST_DAMPING = 2.0**-12
SUFFICIENT_DECREASE = 1e-4


@dataclass(frozen=True, kw_only=True)
class NewtonStep:
    """The state after ``step`` Newton steps; step 0 is the start.

    ``residual`` is the max norm of F, ``damping`` the accepted fraction of the last Newton correction.
    ``stalled`` says that no admissible fraction of the next correction lowers the residual.
    """

    step: int
    z: Array
    residual: float
    damping: float
    stalled: bool = False


def iterate(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], csc_array],
    start: Array,
    *,
    admissible: Callable[[Array], bool],
    tolerance: float,
) -> Iterator[NewtonStep]:
    """Newton steps for ``residual(z) = 0`` from ``start``, until the tolerance is met or the search stalls.

    A step is halved until it **both** lowers the Euclidean norm of the residual and is ``admissible``: without the
    second demand Newton's method converges to folded meshes. The caller owns the loop, and with it the limit on the
    number of steps. The last record has ``residual <= tolerance`` or ``stalled``.
    """
    z, value, damping, step = start, residual(start), 1.0, 0
    while True:
        norm, largest = float(np.linalg.norm(value)), float(np.max(np.abs(value)))
        if largest <= tolerance:
            yield NewtonStep(step=step, z=z, residual=largest, damping=damping)
            return
        accepted = _search(residual, admissible, z, norm, _correction(jacobian(z), value))
        yield NewtonStep(step=step, z=z, residual=largest, damping=damping, stalled=accepted is None)
        if accepted is None:
            return
        z, value, damping = accepted
        step += 1


def _correction(matrix: csc_array, value: Array) -> Array | None:
    try:
        return np.asarray(splu(matrix).solve(-value))
    except RuntimeError:  # SuperLU: the matrix is exactly singular
        return None


def _search(
    residual: Callable[[Array], Array],
    admissible: Callable[[Array], bool],
    z: Array,
    norm: float,
    correction: Array | None,
) -> tuple[Array, Array, float] | None:
    damping = 1.0
    while correction is not None and damping >= SMALLEST_DAMPING:
        candidate = z + damping * correction
        if admissible(candidate):
            value = residual(candidate)
            if np.linalg.norm(value) <= (1.0 - SUFFICIENT_DECREASE * damping) * norm:
                return candidate, value, damping
        damping /= 2
    return None
