"""A solve on a domain in blocks whose subdomains several parts hold: the first one leads, the others follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from equimesh.equations.block_problem import BlockProblem
from equimesh.least_error.block_iteration import BlockSolve
from equimesh.least_error.block_schwarz import BlockSchwarz
from equimesh.least_error.block_subdomains import LEADER, BlockSubdomains
from equimesh.least_error.steps import Descent
from equimesh.monitors.auto import Auto
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.channel import Channel
from equimesh.numerics.types import Array
from equimesh.single_domain.steps import Mode
from equimesh.solving.announcer import Announcer, Event
from equimesh.solving.block_solution import BlockSolution
from equimesh.solving.blocks import solve_blocks
from equimesh.solving.options import Initial, SolveOptions

OWN_FIELDS = ("problem", "mesh")
"""Fields of a solution that whoever asked for it has: the problem, and the mesh but for its nodes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlocksResult:
    """What the leading part found, without the problem: the nodes of the mesh, and the other fields of the solution."""

    points: Array
    """Node coordinates, shape ``(n, 2)``."""
    values: dict[str, Any]

    @classmethod
    def of(cls, solution: BlockSolution) -> BlocksResult:
        """The result of a solution."""
        names = [field.name for field in fields(solution) if field.name not in OWN_FIELDS]
        return cls(points=solution.mesh.points, values={name: getattr(solution, name) for name in names})

    def solution(self, problem: BlockProblem) -> BlockSolution:
        """The solution of ``problem`` again."""
        return BlockSolution(problem=problem, mesh=problem.domain.mesh.moved(self.points), **self.values)


def solve_part_of_blocks(
    channel: Channel,
    problem: BlockProblem,
    settings: BlockSchwarz,
    *,
    threads: int = 1,
    observe: Callable[[Event], None] | None = None,
) -> BlocksResult | None:
    """The result in the part that leads, ``None`` in the others; every part of ``channel.count`` has to call it.

    The mesh is that of :func:`equimesh.solve` with the same settings, bit for bit, on any number of parts. ``observe``
    is called with every step, in the part that leads. The leader solves the coarse meshes and measures the result.
    """
    subdomains = BlockSubdomains(settings=settings, channel=channel)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        if channel.number == LEADER:
            options = SolveOptions(
                mode=Mode.DISCRETIZATION, allow_relaxed=True, threads=threads, observer=Announcer.of(observe)
            )
            found = solve_blocks(problem, Initial.NESTED, options, subdomains)
            subdomains.dismiss()
            return BlocksResult.of(found)
        monitor = _least_error(problem).on(problem.domain)
        solve = BlockSolve(monitor=monitor, domain=problem.domain, threads=threads, subdomains=subdomains)
        for weights, first in subdomains.orders():
            solve.with_weights(weights).follow(first)
    return None


def plain(record: Descent) -> dict[str, Any]:
    """The numbers of a step with its share of the work and its phase, without the mesh."""
    return {**record.numbers(), "fraction": record.fraction, "phase": record.phase}


def _least_error(problem: BlockProblem) -> LeastError:
    """The monitor of the descent."""
    monitor = problem.monitor
    if isinstance(monitor, Auto):
        return monitor.least_error()
    if not isinstance(monitor, LeastError):
        raise TypeError("blocks are solved for the least error")
    return monitor
