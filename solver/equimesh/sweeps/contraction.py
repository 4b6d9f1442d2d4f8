"""The error that remains when every move is smaller than the one before it by a fixed factor."""

import math


def error_left(move: float, contraction: float) -> float:
    """The remaining distance after a ``move``, if each later move is smaller by the factor ``contraction``.

    The sum of a geometric series, in the unit of ``move``; infinite where the moves do not get smaller.
    """
    if contraction < 1.0:
        return move * contraction / (1.0 - contraction)
    return math.inf if move > 0.0 else 0.0
