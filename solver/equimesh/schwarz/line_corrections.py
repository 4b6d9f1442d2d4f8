"""Corrections of all lines of a mesh as a whole: what makes up for interfaces that see only their neighbours."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from equimesh.equations.problem import Problem
from equimesh.equations.rounding import smallest_move
from equimesh.meshes.mesh import Mesh
from equimesh.sweeps.contraction import error_left
from equimesh.sweeps.sweep import Sweep, memory_needed

# The least factor by which later corrections are taken to shrink the moves: errors that last show last.
MIN_CONTRACTION = 0.5


@dataclass(frozen=True)
class CorrectionResult:
    """A mesh after line corrections: ``deviation`` is what the last one found, ``estimate`` the error that is left by
    the contraction of several, NaN where that is not known; ``count`` how many there were."""

    mesh: Mesh
    deviation: float = math.nan
    estimate: float = math.nan
    count: int = 0


class LineCorrections:
    """De Boor's correction of every line by its equidistributing parameter, for both families of lines at once: full
    sweeps of :mod:`equimesh.sweeps.sweep` on the whole grid."""

    def __init__(self, problem: Problem, threads: int) -> None:
        shape = problem.grid.shape
        self._sweep = Sweep(problem.metric, problem.boundary, shape, np.empty(memory_needed(shape)), threads)
        self._floor = smallest_move(shape)

    def apply(self, mesh: Mesh, count: int, enough: float = 0.0) -> CorrectionResult:
        """So many corrections of a valid mesh; fewer where one would fold it, or the error left is small ``enough``.

        ``mesh`` is used up: the corrections work in its memory.
        """
        x, y, done, moves = mesh.x, mesh.y, 0, []
        deviation = math.nan
        for _ in range(count):
            found = self._sweep.correct(x, y)
            if not (math.isfinite(found.move) and self._sweep.smallest_jacobian > 0.0):
                break
            x, y = self._sweep.swap(x, y)
            done, deviation = done + 1, found.deviation
            moves.append(found.move)
            if self._left(moves) <= enough:
                break
        return CorrectionResult(Mesh(x, y), deviation, self._left(moves), done)

    def _left(self, moves: list[float]) -> float:
        if moves and moves[-1] <= self._floor:
            return moves[-1]
        if not moves:
            return math.nan
        contraction = max([MIN_CONTRACTION, *(after / before for before, after in itertools.pairwise(moves))])
        return error_left(moves[-1], contraction)
