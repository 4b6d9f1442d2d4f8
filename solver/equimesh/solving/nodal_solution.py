"""The solution of one round of adapting: the next mesh for the values of a solver."""

import math

from equimesh.equations.block_problem import BlockProblem
from equimesh.equations.problem import Problem
from equimesh.fields.quad_field import QuadField
from equimesh.monitors.nodal_solution import NodalSolution
from equimesh.rounds.next_mesh import KEPT, AnyMesh, Round
from equimesh.rounds.round import adapt_round
from equimesh.solving.block_solution import BlockSolution
from equimesh.solving.solution import Solution, status_unless_folded
from equimesh.solving.status import Status
from equimesh_schema import Candidate, Estimate

NOT_BETTER = "No other mesh is better for these values: this is the mesh that they were given on."


def solve_round(problem: Problem, threads: int) -> Solution:
    """The solution with the next mesh, and with the estimated error of the values on their own mesh.

    Raises :class:`~equimesh.errors.InputError` where the grid is not that of the values.
    """
    monitor = problem.monitor
    if not isinstance(monitor, NodalSolution):
        raise TypeError("a round needs an NodalSolution monitor")
    monitor.require_grid(problem.grid)
    nodal = monitor.nodal
    if isinstance(nodal, QuadField):
        raise TypeError("a round on a grid needs values on a mesh of a grid")
    found = adapt_round(nodal.mesh, nodal.values, problem.domain, monitor.norm, threads)
    return Solution(
        problem=problem,
        schwarz=None,
        mesh=found.mesh,
        reference=found.reference,
        status=status_unless_folded(Status.COMPLETED, folded=found.mesh.is_folded),
        newton_steps=0,
        residual=math.nan,
        note=NOT_BETTER if found.chosen == KEPT else "",
        comparison=_comparison(found, monitor.norm),
        estimate=_estimate(found),
    )


def solve_block_round(problem: BlockProblem, threads: int) -> BlockSolution:
    """One round on a domain in blocks.

    Raises :class:`~equimesh.errors.InputError` for values on a mesh with other cells.
    """
    monitor = problem.monitor
    nodal = monitor.nodal if isinstance(monitor, NodalSolution) else None
    if not isinstance(monitor, NodalSolution) or not isinstance(nodal, QuadField):
        raise TypeError("a round on blocks needs a NodalSolution monitor with values on a mesh of blocks")
    found = adapt_round(nodal.mesh, nodal.values, problem.domain, monitor.norm, threads)
    return BlockSolution(
        problem=problem,
        mesh=found.mesh,
        status=status_unless_folded(Status.COMPLETED, folded=found.mesh.is_folded),
        note=NOT_BETTER if found.chosen == KEPT else "",
        comparison=_comparison(found, monitor.norm),
        estimate=_estimate(found),
        threads=threads,
    )


def _estimate(found: Round[AnyMesh]) -> Estimate:
    return Estimate(
        l2=found.estimate,
        h1=found.estimate_h1,
        unresolved=found.unresolved,
        moved_cells=found.moved_cells,
    )


def _comparison(found: Round[AnyMesh], norm: str) -> tuple[Candidate, ...]:
    """The candidates, the best one first: how many times smaller their errors are than the estimate."""
    before = found.estimate if norm == "l2" else found.estimate_h1
    return tuple(
        Candidate(
            kind="nodal_solution",
            settings={"start": name},
            gain_l2=before / error if norm == "l2" and error > 0.0 else math.nan,
            gain_h1=before / error if norm == "h1" and error > 0.0 else math.nan,
            chosen=name == found.chosen,
        )
        for name, error in sorted(found.candidates.items(), key=lambda item: item[1])
    )
