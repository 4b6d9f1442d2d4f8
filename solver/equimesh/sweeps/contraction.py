"""The error that is left where every move is a fixed factor smaller than the one before it."""

import math


def error_left(move: float, contraction: float) -> float:
    """The distance still to go after a ``move``, if those to come shrink by the factor ``contraction`` each.

    The sum of a geometric series, in the unit of ``move``; infinite where the moves do not shrink.
    """
    if contraction < 1.0:
        return move * contraction / (1.0 - contraction)
    return math.inf if move > 0.0 else 0.0
