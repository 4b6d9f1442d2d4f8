"""When the sweeps of one level end: by the error that is left, that of the grid, and moves that shrink no more."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from equimesh.numerics.compiled import compiled
from equimesh.numerics.types import Array

# Algebraic error that is left in the usual mode, as a share of the discretisation error.
ALGEBRAIC_SHARE = 0.2
# A sweep is slow if it does not reduce the moves by this factor.
MAX_SLOW_CONTRACTION = 0.9
# After more slow sweeps than this, half sweeps are tried, and then another method.
MAX_SLOW_SWEEPS = 3
# The first sweeps from a coarser solution reduce the moves faster than later ones, which reduce them by this factor.
MIN_CONTRACTION = 0.25
# Moves that would fold the mesh are halved, but not below this share.
MIN_MOVE_SHARE = 1 / 128
# A sweep from the uniform mesh keeps at least this share of the smallest Jacobian.
MIN_JACOBIAN_SHARE = 0.2

GO_ON, DONE, LOST = 0, 1, 2
"""Verdicts on a sweep: the level needs more of them, is solved, or cannot be solved by them."""
BEFORE, BEST, SLOW, HALVE, SMALLEST = range(5)
"""What is known of the sweeps so far: the last and the smallest move, the slow sweeps in a row, whether moves are
halved, and the smallest Jacobian."""
RESIDUAL, LEFT, CONTRACTION, GRID_ERROR = range(4)
"""The numbers of a record: the deviation before the sweep, the error left, the contraction, the error of the grid."""


class Rules(NamedTuple):
    """What the sweeps of a level are judged by; it stays the same on the level.

    A ``tight`` level ends at a deviation of ``tolerance``. Another one ends where the error left is a share of that of
    the grid, which is the gap to the coarser solution over ``per_gap``, or where that is not ``known``, at
    ``start_error``. ``contraction`` is the one with which a level begins, that of the coarser one if it ``has_coarse``.
    """

    tight: bool
    known: bool
    has_coarse: bool
    tolerance: float
    start_error: float
    contraction: float
    per_gap: float


class Swept(NamedTuple):
    """A sweep that gave a valid mesh: the verdict on it, its record of four numbers, and the nodes afterwards."""

    verdict: int
    record: list[float]
    x: Array
    y: Array


def nothing_known(smallest: float) -> Array:
    """What is known before the first sweep of a level, in a mesh of this ``smallest`` Jacobian."""
    return np.array([np.inf, np.inf, 0.0, 0.0, smallest])


@compiled
def judge(rules: Rules, known: Array, move: float, share: float, gap: float, record: Array) -> int:
    """The verdict on a sweep of this ``move``, of which a ``share`` was taken; ``gap`` is that to the coarser solution.

    ``record`` holds the deviation, and receives its other numbers. ``known`` is brought up to date.
    """
    contraction = rules.contraction
    if np.isfinite(known[BEFORE]) and known[BEFORE] > 0.0:
        contraction = max(MIN_CONTRACTION, move / known[BEFORE])
    left = error_left(move, contraction) if share == 1.0 else np.inf
    error = gap / rules.per_gap
    record[LEFT], record[CONTRACTION], record[GRID_ERROR] = left, contraction, error
    if rules.tight:
        done = record[RESIDUAL] <= rules.tolerance
    elif rules.known:
        done = np.isfinite(left) and left <= ALGEBRAIC_SHARE * error
    else:
        done = left <= rules.start_error
    if done:
        return DONE
    known[SLOW] = 0.0 if move < MAX_SLOW_CONTRACTION * known[BEST] else known[SLOW] + 1.0
    known[BEFORE], known[BEST] = move, min(known[BEST], move)
    if known[SLOW] > MAX_SLOW_SWEEPS and rules.has_coarse:
        if known[HALVE] > 0.0:
            return LOST
        known[BEFORE], known[BEST], known[SLOW], known[HALVE] = np.inf, np.inf, 0.0, 1.0
    return GO_ON


@compiled
def error_left(move: float, contraction: float) -> float:
    """The remaining distance after a ``move``, if each later move is smaller by the factor ``contraction``.

    The sum of a geometric series, in the unit of ``move``; infinite where the moves do not get smaller.
    """
    if contraction < 1.0:
        return move * contraction / (1.0 - contraction)
    return np.inf if move > 0.0 else 0.0
