"""Rounding errors: of positions, of the moves of a sweep, and of residuals."""

import numpy as np

from equimesh.equations.metric import ReferenceMetric
from equimesh.equations.problem import Problem

# Changes of a coordinate that rounding alone can cause, per point in a direction.
POSITION_ROUNDING = 1e-13
# The additional change per point, for each multiple of its variation by which u is larger.
CANCELLED_ROUNDING = 1e-14
# Moves of a coordinate that rounding alone causes in one sweep, per point in a direction.
MOVE_ROUNDING = 1e-15
# Relative residuals that rounding alone causes, per point in a direction.
RESIDUAL_ROUNDING = 64 * np.finfo(np.float64).eps


def smallest_tolerance(problem: Problem) -> float:
    """The rounding error of a node position. No smaller tolerance can be met."""
    return max(problem.grid.shape) * (POSITION_ROUNDING + CANCELLED_ROUNDING * (problem.metric.cancellation - 1.0))


def smallest_move(shape: tuple[int, int]) -> float:
    """The move of a coordinate that rounding alone causes in a sweep. Smaller moves do not fall any more."""
    return MOVE_ROUNDING * max(shape)


def smallest_residual(metric: ReferenceMetric, shape: tuple[int, int]) -> float:
    """The rounding error of a relative residual on a grid: larger where u varies little compared with its size."""
    return float(RESIDUAL_ROUNDING * max(shape) * metric.cancellation)
