"""What rounding leaves: of positions, of the moves of a sweep, and of residuals."""

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.problem import Problem

# Changes of a coordinate that rounding alone can cause, per point in a direction.
POSITION_ROUNDING = 1e-13
# The same once more, for every time that u is larger than its variation.
CANCELLED_ROUNDING = 1e-14
# Moves of a coordinate that rounding alone causes in one sweep, per point in a direction.
MOVE_ROUNDING = 1e-15
# Relative residuals that rounding alone causes, per point in a direction.
RESIDUAL_ROUNDING = 64 * np.finfo(np.float64).eps


def smallest_tolerance(problem: Problem) -> float:
    """The error of a node position that rounding leaves. No smaller tolerance can be met."""
    return max(problem.grid.shape) * (POSITION_ROUNDING + CANCELLED_ROUNDING * (problem.metric.cancellation - 1.0))


def smallest_move(shape: tuple[int, int]) -> float:
    """The move of a coordinate that rounding alone causes in a sweep. Smaller moves do not shrink any more."""
    return MOVE_ROUNDING * max(shape)


def smallest_residual(metric: ReferenceMetric, shape: tuple[int, int]) -> float:
    """The relative residual that rounding leaves on a grid: larger where u varies little compared with its size."""
    return float(RESIDUAL_ROUNDING * max(shape) * metric.cancellation)
