"""One mesh in parts: the coarse solution, and what every part does from there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from equimesh.equations.problem import Problem
from equimesh.meshes.grid import Grid
from equimesh.numerics.channel import Channel
from equimesh.parts.part_solution import PartSolution, PartStep
from equimesh.single_domain.steps import Mode, Step

# Points of the coarse solution, at most: it is computed by one process.
MAX_COARSE_POINTS = 1025 * 1025


@dataclass(frozen=True, kw_only=True, eq=False)
class CoarseSolution:
    """The solution on the finest nested grid that is solved whole, and the one on the grid below it.

    It can be pickled, and sent to every part. Every attempt to compute the parts begins with it.
    """

    grid: Grid
    """The grid of the coarse solution."""

    def for_part(self, number: int, count: int) -> CoarseSolution:
        """What part ``number`` of ``count`` needs of it: fewer rows, to send less."""
        raise NotImplementedError


def coarse_solution(
    problem: Problem,
    *,
    mode: Mode = Mode.DISCRETIZATION,
    allow_relaxed: bool = True,
    threads: int | None = None,
    observe: Callable[[Step], None] | None = None,
    max_points: int = MAX_COARSE_POINTS,
) -> CoarseSolution:
    """The coarse solution of ``problem``, on at most ``max_points`` points, by one process.

    Raises :class:`~equimesh.errors.InputError` for a monitor that has no metric, with what to take instead, and
    :class:`~equimesh.solving.solution.SolveError` where the coarse grid has no solution, or only a relaxed one and
    ``allow_relaxed`` is false.
    """
    raise NotImplementedError


def most_parts(problem: Problem, max_points: int = MAX_COARSE_POINTS) -> int:
    """The largest number of parts that the grids of ``problem`` can be cut into."""
    raise NotImplementedError


def solve_part(
    problem: Problem,
    coarse: CoarseSolution,
    channel: Channel,
    *,
    mode: Mode = Mode.DISCRETIZATION,
    threads: int = 1,
    observe: Callable[[PartStep], None] | None = None,
) -> PartSolution:
    """Part ``channel.number`` of the solution of ``problem``; every part of ``channel.count`` has to call it.

    The mesh is equal to that of :func:`equimesh.solve` to the last bit. ``observe`` is called after every sweep.
    Raises :class:`~equimesh.errors.InputError` for more parts than :func:`most_parts`.
    """
    raise NotImplementedError
