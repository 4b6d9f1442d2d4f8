"""The solve of one part of a mesh, from the coarse solution to its rows of the finest grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from equimesh.domains.domain import Domain, Rectangle
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.meshes.folding import smallest_in_parts
from equimesh.meshes.held_mesh import HeldMesh
from equimesh.meshes.mesh_part import MeshPart
from equimesh.meshes.parts import Parts
from equimesh.numerics.channel import Channel, Counted
from equimesh.single_domain.iteration import Climb
from equimesh.single_domain.steps import Step, Steps
from equimesh.solving.single_domain import outcome
from equimesh_cluster.parts.coarse import CoarseSolution, OtherGridsNeededError
from equimesh_cluster.parts.part_solution import PartSolution, PartStep

# Nodes that are mapped to the domain at a time: what a map needs in between stays small.
MAX_MAPPED_NODES = 262_144

Observer = Callable[[PartStep], None]


def solve_part(
    problem: Problem,
    coarse: CoarseSolution,
    channel: Channel,
    *,
    threads: int = 1,
    observe: Observer | None = None,
) -> PartSolution:
    """Part ``channel.number`` of the solution of ``problem``; every part of ``channel.count`` has to call it.

    ``coarse`` is the coarse solution of the same problem, or what :meth:`CoarseSolution.for_part` takes of it. The mesh
    is equal to that of :func:`equimesh.solve` to the last bit, and so are its mode, its estimates and its status.
    ``observe`` is called after every sweep.

    Raises :class:`~equimesh.errors.InputError` for more parts than :attr:`CoarseSolution.most_parts`,
    :class:`~equimesh_cluster.parts.coarse.OtherGridsNeededError`, and :class:`~equimesh.numerics.channel.PeerError`.
    """
    if channel.count > coarse.most_parts:
        raise InputError(
            f"parts = {channel.count}: the grids of this solve can be cut into at most {coarse.most_parts} parts",
            field="parts",
        )
    counted, first = Counted(channel), coarse.level + 1
    parts = Parts.of(problem.grid.shape, threads, counted)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        last, records = coarse.last, list[PartStep]()
        if first < len(coarse.grids):
            climb = Climb(
                problem, coarse.mode, threads, coarse.grids, channel=counted, first=first, solved=coarse.solved
            )
            last = _last_of(climb.by_sweeps(only_requested=coarse.only_requested), counted, records, observe)
            reference = HeldMesh(problem.grid, parts.begin, last.mesh.x, last.mesh.y)
            del climb
        else:
            reference = coarse.solved[-1].mesh.window(parts.begin, parts.end)
        mesh = _mapped(reference, problem.domain, parts)
        is_mapped = mesh.x is not reference.x
        folded = is_mapped and not smallest_in_parts(mesh.x, mesh.y, parts) > 0.0
    return PartSolution(
        problem=problem,
        mode=coarse.mode,
        mesh=_part_of(mesh, parts),
        reference=reference,
        threads=threads,
        records=tuple(records),
        **outcome(last, problem, allow_relaxed=coarse.allow_relaxed, folded=folded),
    )


def _last_of(steps: Steps, channel: Counted, records: list[PartStep], observe: Observer | None) -> Step:
    """The last step, after all steps were recorded and reported to the observer."""
    while True:
        try:
            step = next(steps)
        except StopIteration as end:
            if end.value is None:
                raise OtherGridsNeededError("sweeps have no solution on a nested grid") from None
            last: Step = end.value
            return last
        records.append(
            PartStep(
                level=step.level,
                levels=step.levels,
                grid=step.grid,
                step=step.step,
                residual=step.residual,
                algebraic_error=step.algebraic_error,
                discretization_error=step.discretization_error,
                contraction=step.contraction,
                converged=step.converged,
                traffic=channel.taken(),
            )
        )
        if observe is not None:
            observe(records[-1])


def _mapped(mesh: HeldMesh, domain: Domain, parts: Parts) -> HeldMesh:
    """The rows of the mesh of the domain that are held; those of ``mesh`` itself where the map is the identity."""
    if isinstance(domain, Rectangle) and domain.is_unit_square:
        return mesh
    x, y = np.empty(mesh.x.shape), np.empty(mesh.y.shape)
    rows = max(1, MAX_MAPPED_NODES // mesh.grid.n_eta)
    blocks = [slice(row, row + rows) for row in range(0, len(x), rows)]

    def work(number: int) -> None:
        for block in blocks[number :: parts.communicator.size]:
            x[block], y[block] = domain.map(mesh.x[block], mesh.y[block])

    parts.communicator.each(work)
    return HeldMesh(mesh.grid, mesh.begin, x, y)


def _part_of(mesh: HeldMesh, parts: Parts) -> MeshPart:
    """The own rows of a mesh, and the first one of the next part."""
    first, last = parts.own.ends
    rows = mesh.window(first, min(last + 1, mesh.grid.n_xi))
    number, count = parts.channel.number, parts.channel.count
    return MeshPart(grid=mesh.grid, number=number, count=count, first=first, last=last, x=rows.x, y=rows.y)
