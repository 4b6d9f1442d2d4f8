"""Chord sweeps on the window of one subdomain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import numpy as np

from equimesh.equations.mesh_equations import MeshEquations
from equimesh.equations.newton_solve import NewtonSolution, smallest_move
from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.rows import Rows
from equimesh.numerics.types import Array, Pair
from equimesh.schwarz.decomposition import Place, SubdomainWindow
from equimesh.schwarz.records import SubdomainRecord
from equimesh.sweeps.sweep import Frame, Sweep, memory_needed, take_midpoints

# The interface between the Schwarz iteration and its subdomains, for every family of transmission conditions.

# Newton steps of one subdomain solve. A start near a solution needs fewer.
MAX_LOCAL_STEPS = 25


@dataclass(frozen=True)
class Outcome:
    """A local solution, and whether classical data took the place of the requested condition."""

    solution: NewtonSolution
    classical: bool = False

    def record(self, k: int, earlier: SubdomainRecord | None) -> SubdomainRecord:
        """The record of subdomain ``k``, added to an ``earlier`` one of the same iteration."""
        solution = self.solution
        steps, sweeps = (0, solution.steps) if solution.swept else (solution.steps, 0)
        record = SubdomainRecord(
            subdomain=k,
            newton_steps=steps,
            sweeps=sweeps,
            residual=solution.residual,
            stalled=not solution.converged,
            classical=self.classical,
        )
        if earlier is None:
            return record
        return replace(
            record,
            newton_steps=steps + earlier.newton_steps,
            sweeps=sweeps + earlier.sweeps,
            stalled=record.stalled or earlier.stalled,
            classical=record.classical or earlier.classical,
        )


@dataclass(frozen=True)
class MergedSolutions:
    """The subdomains after their solves of one iteration, and the merged mesh.

    ``states`` are their solutions, ``records`` the records of all subdomains. ``mismatch`` is the largest difference
    between a subdomain and the merged mesh.
    """

    mesh: Mesh
    states: tuple[Mesh, ...]
    records: tuple[SubdomainRecord, ...]
    mismatch: float

    @property
    def has_stalled(self) -> bool:
        """Whether no solution was found in a subdomain."""
        return any(record.stalled for record in self.records)

    @property
    def is_rescued(self) -> bool:
        """Whether classical data took the place of the requested condition in a subdomain."""
        return any(record.classical for record in self.records)


class Slopes(Protocol):
    """The derivative of the data of all subdomains by the merged mesh that they read."""

    def received(self, change: Pair) -> list[Array]:
        """The change of the right side of every subdomain's equations, when the merged mesh moves by ``change``."""
        ...


class Subdomains(Protocol):
    """All subdomains of a decomposition, and what they exchange."""

    windows: list[SubdomainWindow]

    def restart(self, mesh: Mesh) -> None:
        """Continue from ``mesh``, which is not the mesh that was merged last."""
        ...

    def begin(self, mesh: Mesh, turn: Sequence[int] | None = None) -> None:
        """Exchange data: the next solves read the merged mesh ``mesh`` and the solutions of the neighbours.

        These are the solves of the subdomains of a ``turn``, else of all.
        """
        ...

    def solve(self, k: int) -> Outcome:
        """The solution of a subdomain with the data that was exchanged."""
        ...

    def keep(self, k: int, state: Mesh) -> None:
        """Keep the solution ``state`` of a subdomain for its neighbours."""
        ...

    def place(self, k: int) -> Place:
        """The nodes that the merged mesh takes from a subdomain."""
        ...

    def state(self, k: int, mesh: Mesh) -> Mesh:
        """The solution of a subdomain after an iteration with the result ``mesh``."""
        ...

    def sent(self, turn: Sequence[int]) -> int:
        """Numbers that subdomains send each other before the solves of a turn."""
        ...

    def equations(self, k: int) -> MeshEquations:
        """The equations of a subdomain, with the data that was exchanged."""
        ...

    def slopes(self, states: Sequence[Mesh]) -> Slopes:
        """The derivative of the data, where the subdomains have the solutions ``states``."""
        ...


Rest: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]


class SubdomainSweeps:
    """Sweeps of line corrections on a window, with their working memory."""

    def __init__(self, problem: Problem, shape: tuple[int, int], frame: Frame) -> None:
        self._sweep = Sweep(problem.metric, problem.boundary, Rows.whole(shape), np.empty(memory_needed(shape)), frame)
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
