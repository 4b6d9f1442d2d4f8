"""Chord sweeps on the window of one subdomain."""

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from equimesh.equations.newton_solve import NewtonSolution, smallest_move
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array
from equimesh.sweeps.sides import Frame
from equimesh.sweeps.sweep import Sweep, memory_needed, take_midpoints

Rest: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]


class SubdomainSweeps:
    """Sweeps of line corrections on a window, with their working memory."""

    def __init__(self, problem: Problem, shape: tuple[int, int], frame: Frame) -> None:
        self._sweep = Sweep(problem.metric, problem.boundary, Parts.of(shape), np.empty(memory_needed(shape)), frame)
        self._floor = smallest_move(shape)

    def solve(
        self, start: Mesh, rest: Rest | None, *, accuracy: float, most: int, enough: float = 0.0
    ) -> NewtonSolution:
        """Sweep from ``start``, whose nodes on interfaces are held, until moves are ``accuracy`` times the first one.

        The sweeps also end with moves of at most ``enough``, in units of the reference square, and after ``most``
        sweeps. They overwrite ``start``. ``rest`` returns sums of metric lengths beyond yielding sides. The solution
        is ``converged`` where the moves fell; its residual is the deviation before the last sweep.
        """
        x, y, moves = start.x, start.y, [math.inf]
        for count in range(1, most + 1):
            found = self._sweep.correct(x, y, None if rest is None else rest(x, y))
            smallest = self._sweep.guard(x, y, found, shorten=take_midpoints).smallest
            if not (math.isfinite(found.deviation) and smallest > 0.0):
                return NewtonSolution(start, count, math.inf, converged=False, swept=True)
            x, y = self._sweep.swap(x, y)
            moves.append(found.move)
            if found.move <= max(accuracy * moves[1], self._floor, enough):
                break
        fell = moves[-1] < moves[1] or moves[-1] <= max(self._floor, enough) or most == 1
        return NewtonSolution(Mesh(x, y), count, found.deviation, converged=fell, swept=True)
