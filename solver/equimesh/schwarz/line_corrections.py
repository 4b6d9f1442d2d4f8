"""Corrections of all grid lines of a mesh as a whole, which pass information across all interfaces at once."""

import itertools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from equimesh.equations.newton_solve import smallest_move
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.parts import Parts
from equimesh.numerics.types import Array
from equimesh.schwarz.holding.on_channel import OnChannel
from equimesh.schwarz.holding.port import Holding
from equimesh.schwarz.lines.held_sweep import HeldSweep
from equimesh.sweeps.sweep import Correction, Sweep, error_left, memory_needed

# Later corrections are not assumed to reduce the moves by a smaller factor: slow errors show late.
MIN_CONTRACTION = 0.5


@dataclass(frozen=True)
class CorrectionResult:
    """A mesh after ``count`` line corrections; ``tried`` also counts one that was not taken.

    ``deviation`` is that before the last correction, ``estimate`` the remaining error by the contraction of the moves.
    Both are NaN where not known.
    """

    mesh: Mesh
    deviation: float = math.nan
    estimate: float = math.nan
    count: int = 0
    tried: int = 0


class LineSweep(Protocol):
    """Corrections of all lines of a mesh, as :class:`~equimesh.sweeps.sweep.Sweep` has them."""

    def correct(self, x: Array, y: Array) -> Correction:
        """One correction of the nodes ``x``, ``y``."""
        ...

    @property
    def smallest_jacobian(self) -> float:
        """The smallest corner Jacobian of the moved nodes."""
        ...

    def swap(self, x: Array, y: Array) -> tuple[Array, Array]:
        """The moved nodes; ``x`` and ``y`` are the memory for the next ones."""
        ...


class LineCorrections:
    """De Boor's correction of all lines of both families at once: full sweeps on the whole grid."""

    def __init__(self, problem: Problem, threads: int, holding: Holding | OnChannel | None = None) -> None:
        """On the whole grid, or where ``holding`` has the subdomains held by several processes in their windows."""
        shape = problem.grid.shape
        self._sweep: LineSweep
        if isinstance(holding, OnChannel):
            self._sweep = HeldSweep(problem, holding)
        else:
            parts, memory = Parts.of(shape, threads), np.empty(memory_needed(shape))
            self._sweep = Sweep(problem.metric, problem.boundary, parts, memory)
        self._floor = smallest_move(shape)

    def apply(self, mesh: Mesh, count: int, enough: float = 0.0) -> CorrectionResult:
        """``count`` corrections of a valid mesh; fewer where one would fold it, or the error is at most ``enough``.

        ``mesh`` is overwritten.
        """
        x, y, done, tried, moves = mesh.x, mesh.y, 0, 0, []
        deviation = math.nan
        for _ in range(count):
            tried += 1
            found = self._sweep.correct(x, y)
            if not (math.isfinite(found.move) and self._sweep.smallest_jacobian > 0.0):
                break
            x, y = self._sweep.swap(x, y)
            done, deviation = done + 1, found.deviation
            moves.append(found.move)
            if self._left(moves) <= enough:
                break
        return CorrectionResult(Mesh(x, y), deviation, self._left(moves), done, tried)

    def _left(self, moves: list[float]) -> float:
        if moves and moves[-1] <= self._floor:
            return moves[-1]
        if not moves:
            return math.nan
        contraction = max([MIN_CONTRACTION, *(after / before for before, after in itertools.pairwise(moves))])
        return error_left(moves[-1], contraction)
