"""A mesh that was solved whole, in parts on workers: what a handle holds, without a solve in parts."""

from __future__ import annotations

from typing import Any

from distributed import Client

import equimesh as em
from equimesh.meshes.mesh import MeshRows
from equimesh_cluster.handle import Handle
from equimesh_cluster.mesh_part import cut
from equimesh_cluster.messages import Traffic
from equimesh_cluster.parts.part_solution import PartSolution, PartStep
from equimesh_cluster.run import PartsRun, run_parts

PROBLEM = em.Problem(monitor=em.ArcLength(u=em.Expression("tanh(8*x)*y")), grid=em.Grid(n_xi=33, n_eta=17))


def part_of(channel: Any, solution: em.Solution, cuts: tuple[int, ...]) -> PartSolution:
    """One part of a solution that was solved whole."""
    mesh = cut(solution.mesh, cuts)[channel.number]
    begin, end = max(0, mesh.first - 1), min(mesh.last + 1, mesh.grid.n_xi)
    held = MeshRows.of(solution.reference).within(begin, end)
    record = PartStep(
        level=1,
        levels=2,
        grid=mesh.grid,
        step=1,
        residual=0.5,
        algebraic_error=0.0,
        discretization_error=0.0,
        contraction=0.1,
        converged=True,
        traffic={"halo": Traffic(2, 10 * (channel.number + 1))},
    )
    return PartSolution(
        problem=solution.problem,
        mode=em.Mode.DISCRETIZATION,
        status=solution.status,
        mesh=mesh,
        reference=held,
        newton_steps=solution.newton_steps,
        residual=solution.residual,
        records=(record,),
    )


def parts_on(client: Client, solution: em.Solution, *cuts: int) -> PartsRun:
    """The parts of a solution on workers."""
    return run_parts(client, part_of, lambda _, __: (solution, cuts), parts=len(cuts) + 1)


def handle_on(client: Client, solution: em.Solution, *cuts: int) -> Handle:
    """A handle of a solution that was solved whole."""
    return Handle(solution.problem, client, parts_on(client, solution, *cuts), own_client=False)
