"""A solve in parts whose parts are threads of this process: the same code as on many machines."""

from __future__ import annotations

from functools import partial

from equimesh.equations.problem import Problem
from equimesh.numerics.channel import Channel, ThreadChannels
from equimesh_cluster.parts.coarse import CoarseSolution, OtherGridsNeededError, coarse_solution
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.parts.solve import solve_part


def solve_in_threads(problem: Problem, count: int, coarse: CoarseSolution) -> list[PartSolution]:
    """The ``count`` parts of the solution of ``problem``, from its coarse solution, each on a thread of its own.

    Raises the error of a part that failed.
    """

    def work(start: CoarseSolution, channel: Channel) -> PartSolution:
        return solve_part(problem, start.for_part(channel.number, count), channel)

    try:
        return ThreadChannels(count).run(partial(work, coarse))
    except OtherGridsNeededError:
        square = coarse_solution(
            problem, mode=coarse.mode, allow_relaxed=coarse.allow_relaxed, max_points=coarse.grid.points, square=True
        )
        return ThreadChannels(count).run(partial(work, square))
