"""One step: solve from the previous mesh; if u moved more than a cell, also from a new start, and in substeps.

A descent from the mesh before is sooner done than one from a uniform mesh, and loses where a front moves by more than
a cell. What it has lost is measured: the error of the mesh, relative to that of the uniform mesh. Then a nested start
is tried, and substeps with u interpolated in time, and the smallest error decides.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from equimesh.equations.block_problem import BlockProblem
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.fields.field import Field
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_mesh import QuadMesh
from equimesh.monitors.auto import Auto
from equimesh.monitors.intersection import Intersection
from equimesh.monitors.least_error import LeastError
from equimesh.monitors.nodal_solution import NodalSolution
from equimesh.schwarz.settings import Schwarz
from equimesh.sequences.between import Between
from equimesh.sequences.following import with_u
from equimesh.sequences.moves import cells_moved
from equimesh.solving.block_solution import BlockSolution
from equimesh.solving.options import Initial, SolveArguments
from equimesh.solving.solution import Solution
from equimesh.solving.solve import solve

# A gain less than this share of that of the step before calls for a nested start, which costs as much again.
MIN_GAIN_SHARE = 0.8
# A gain less than this share of the one before, in spite of a nested start, calls for substeps.
MIN_GAIN_SHARE_WITHOUT_SUBSTEPS = 0.5
# Substeps, at most, of one step.
MAX_SUBSTEPS = 8


S = TypeVar("S", Solution, BlockSolution)
P = TypeVar("P", Problem, BlockProblem)
M = TypeVar("M", Mesh, QuadMesh)


@dataclass(frozen=True, kw_only=True)
class Found(Generic[S]):
    """The solution of a step, and the number of meshes on the way to it."""

    solution: S
    substeps: int = 1

    @property
    def gain(self) -> float:
        """The error on the uniform mesh, on blocks the initial one, over that on this one; NaN where there is none."""
        return gain_of(self.solution)


@dataclass(frozen=True, kw_only=True)
class Earlier:
    """A mesh whose solution is gone: its ``u``, or None, and its ``gain``, or NaN."""

    u: Field | None = None
    gain: float = math.nan


@dataclass(frozen=True, kw_only=True)
class AnyPursuit(ABC, Generic[P, S, M]):
    """Finds the mesh of the next step after ``before``, whose u was ``u``; ``None`` where it is not known."""

    options: SolveArguments
    before: M
    """The mesh before, on the reference square and the grid of the step; of blocks the mesh itself."""
    u: Field | None
    gain: float
    """The gain of the mesh before for its u; NaN where it is not known."""
    max_move: float

    def solve(self, problem: P) -> Found[S]:
        """The solution with the smallest measured error of those that were needed."""
        found = Found(solution=self._from(problem, self.before))
        if isinstance(problem.monitor, Auto) and problem.monitor.purpose is not None:
            return found  # its meshes are chosen by another error than that of interpolation, and for each u anew
        # A mesh that has kept its gain is better than one that is a little better and far away.
        is_followed = not math.isnan(self.gain) or self._moved(found) <= self.max_move
        if is_followed and not self._has_lost(found, MIN_GAIN_SHARE):
            return found
        if isinstance(problem.monitor, LeastError | Auto) and self._may_start_anew:
            found = _better(found, Found(solution=self._from(problem, Initial.NESTED)))
        if self._has_lost(found, MIN_GAIN_SHARE_WITHOUT_SUBSTEPS) and self._moved(found) > self.max_move:
            found = _better(found, self._in_substeps(problem, self._moved(found)))
        return found

    def _in_substeps(self, problem: P, moved: float) -> Found[S] | None:
        """The solution by several meshes, each from the one before it; ``None`` where u is not known at both times."""
        later = problem.monitor.u
        if self.u is None or later is None or isinstance(problem.monitor, Intersection):
            return None  # the members of an intersection may have several u
        count = min(math.ceil(moved / self.max_move), MAX_SUBSTEPS)
        mesh = self.before
        for number in range(1, count):
            u = Between(earlier=self.u, later=later, share=number / count)
            try:
                between = self._with(problem, u)
            except InputError:
                return None
            solution = self._from(between, mesh)
            if not solution.status.succeeded:
                return None
            mesh = self._place(solution)
        return Found(solution=self._from(problem, mesh), substeps=count)

    @property
    def _may_start_anew(self) -> bool:
        """Whether a nested start is tried."""
        return True

    @abstractmethod
    def _from(self, problem: P, start: M | Initial) -> S:
        """The solution from a start."""

    @abstractmethod
    def _with(self, problem: P, u: Field) -> P:
        """The problem with another u; raises :class:`~equimesh.errors.InputError` where it follows none."""

    @abstractmethod
    def _place(self, solution: S) -> M:
        """The mesh of a solution, as :attr:`before`."""

    def _has_lost(self, found: Found[S], share: float) -> bool:
        return not found.solution.status.succeeded or found.gain < share * self.gain

    def _moved(self, found: Found[S]) -> float:
        return cells_moved(self.before, self._place(found.solution))


@dataclass(frozen=True, kw_only=True)
class Pursuit(AnyPursuit[Problem, Solution, Mesh]):
    """On a grid."""

    schwarz: Schwarz | None

    @property
    def _may_start_anew(self) -> bool:
        return self.schwarz is None

    def _from(self, problem: Problem, start: Mesh | Initial) -> Solution:
        options: SolveArguments = {**self.options, "initial": start, "check": False}
        return solve(problem, self.schwarz, **options)

    def _with(self, problem: Problem, u: Field) -> Problem:
        return replace(problem, monitor=with_u(problem.monitor, u))

    def _place(self, solution: Solution) -> Mesh:
        return solution.reference


@dataclass(frozen=True, kw_only=True)
class BlockPursuit(AnyPursuit[BlockProblem, BlockSolution, QuadMesh]):
    """On blocks."""

    def _from(self, problem: BlockProblem, start: QuadMesh | Initial) -> BlockSolution:
        options: SolveArguments = {**self.options, "initial": start, "check": False}
        return solve(problem, **options)

    def _with(self, problem: BlockProblem, u: Field) -> BlockProblem:
        return problem_with(problem, u)

    def _place(self, solution: BlockSolution) -> QuadMesh:
        return solution.mesh


def problem_with(problem: BlockProblem, u: Field) -> BlockProblem:
    """A problem on blocks with another u; raises :class:`~equimesh.errors.InputError` for a monitor of values."""
    monitor = problem.monitor
    if isinstance(monitor, NodalSolution):
        raise InputError("a NodalSolution follows no function u: take LeastError or Auto", field="u")
    return replace(problem, monitor=replace(monitor, u=u))


def gain_of(solution: Solution | BlockSolution) -> float:
    """The gain of a mesh in the norm of its monitor; NaN where there is no u."""
    errors = solution.interpolation
    return math.nan if errors is None else errors.estimated_gain(getattr(solution.problem.monitor, "norm", "l2"))


def _better(one: Found[S], other: Found[S] | None) -> Found[S]:
    """The one with the larger gain, of those that succeeded."""
    if other is None or not other.solution.status.succeeded:
        return one
    if not one.solution.status.succeeded or other.gain > one.gain:
        return other
    return one
