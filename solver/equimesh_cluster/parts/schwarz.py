"""The Schwarz iteration in parts: subdomains of a grid, and blocks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from equimesh.blocks.blocks import Blocks
from equimesh.domains.domain import map_mesh
from equimesh.equations.newton_solve import MAX_FACTORISED_POINTS
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.least_error.descent import Descent
from equimesh.least_error.iteration import LeastErrorSolve
from equimesh.meshes.mesh import Mesh, MeshRows
from equimesh.meshes.rows import Rows
from equimesh.monitors.least_error import Auto, LeastError
from equimesh.numerics.types import Array
from equimesh.schwarz.decomposition import SubdomainWindow, common
from equimesh.schwarz.iteration import iterations_on
from equimesh.schwarz.records import IterationNumbers
from equimesh.schwarz.settings import Acceleration, Schwarz
from equimesh.single_domain.level import Mode
from equimesh.solving.certificate import safe_discretization_error
from equimesh.solving.schwarz import ending_of
from equimesh.solving.single_domain import require_open
from equimesh.solving.solution import OnBlocks, Solution
from equimesh.solving.solve import Best, method_of
from equimesh.solving.status import Announcer, Event, Initial, SolveOptions
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.messages import Channel, Traffic
from equimesh_cluster.parts.checkpoints import Checkpoints, keep, resumed
from equimesh_cluster.parts.holding import GHOSTS, OnChannel, holder, moved
from equimesh_cluster.parts.least_error import LEADER, PartMinimiseError, PartSubdomains
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.parts.rows import with_halos


@dataclass(frozen=True, kw_only=True)
class SchwarzPlan:
    """The input of all parts of a Schwarz iteration."""

    problem: Problem
    schwarz: Schwarz
    tolerance: float | None
    """The error at which the iteration ends, as a number; ``None`` runs exactly ``schwarz.max_iterations``."""
    expected: float
    """The expected error of the discretisation; NaN where it is not known."""
    nested: bool = True
    """Whether the start was interpolated from a coarser grid."""
    threads: int = 1
    """The threads of each part, which share its subdomains."""
    shows: bool = False
    """Whether the first part assembles the mesh of every record."""

    def __post_init__(self) -> None:
        require_open(self.problem, self.schwarz)
        self.schwarz.decompose(self.problem.grid)
        if self.schwarz.accelerated_by is Acceleration.NEWTON and self.problem.grid.points > MAX_FACTORISED_POINTS:
            raise InputError(
                'acceleration = "newton" on several machines: one of them takes the steps, on whole meshes of at most'
                f' {MAX_FACTORISED_POINTS} points, and this grid has {self.problem.grid.points}: take "anderson"',
                field="schwarz.acceleration",
            )

    def windows(self, mesh: Mesh, number: int, count: int) -> dict[int, Mesh]:
        """The windows of a mesh of the whole grid for part ``number`` of ``count``."""
        decomposition = self.schwarz.decompose(self.problem.grid)
        held = [part for part in decomposition.parts if holder(part.number, len(decomposition.parts), count) == number]
        return {part.number: SubdomainWindow(decomposition, part, GHOSTS).restrict(mesh) for part in held}


@dataclass(frozen=True, kw_only=True, eq=False)
class SchwarzPart(PartSolution):
    """The rows of one part of the mesh of a Schwarz iteration; ``newton_steps`` counts sweeps, too."""

    iterations: tuple[IterationNumbers, ...]
    """The records of this attempt; with meshes in the first part, where they are shown."""
    sent: tuple[dict[str, Traffic], ...]
    """The traffic of this part in each of these iterations, by the kind of the message."""
    detours: tuple[str, ...]
    """Sentences about deviations of the solve from the request."""
    resumed: int | None
    """The iteration from whose mesh this attempt went on, after a process was lost; ``None`` for the start."""


def iterate_part(
    channel: Channel,
    plan: SchwarzPlan,
    start: Mapping[int, Mesh],
    reference: Mapping[int, Mesh] | None = None,
    *,
    kept: Checkpoints | None = None,
    observe: Callable[[IterationNumbers], None] | None = None,
) -> SchwarzPart:
    """Part ``channel.number`` of the mesh of a Schwarz iteration; every part of ``channel.count`` has to call it.

    ``start`` and ``reference`` are the windows of :meth:`SchwarzPlan.windows`. The iterates are equal to those of
    :func:`equimesh.schwarz.iteration.schwarz_iterations`. ``kept`` are the copies of this process: with them the
    iteration continues from the newest iterate whose copies are still in the processes of the parts. Raises
    :class:`~equimesh.errors.InputError` for more parts than subdomains.
    """
    problem, schwarz = plan.problem, plan.schwarz
    holding = OnChannel(channel, schwarz.decompose(problem.grid), shows=plan.shows)
    begun = None if kept is None else resumed(holding, kept, schwarz.max_iterations - 1)
    first, mesh = (0, holding.joined(start)) if begun is None else begun
    last = mesh
    exact = None if reference is None else holding.joined(reference)
    settings = replace(schwarz, tolerance=plan.tolerance)
    records: list[IterationNumbers] = []
    sent: list[dict[str, Traffic]] = []
    for record, last in iterations_on(holding, problem, settings, mesh, exact, threads=plan.threads, first=first):
        done = record.meets(plan.tolerance) or record.iteration >= schwarz.max_iterations
        if kept is not None and record.iteration > 0 and not done:
            keep(holding, kept, record.iteration, last)
        records.append(record)
        sent.append(holding.channel.taken())
        if observe is not None:
            observe(record)
        if done:
            break
    return _part(plan, holding, last, records, sent, None if begun is None else first)


def _part(
    plan: SchwarzPlan,
    holding: OnChannel,
    mesh: Mesh,
    records: list[IterationNumbers],
    sent: list[dict[str, Traffic]],
    first: int | None,
) -> SchwarzPart:
    """The result of a part, from its windows of the last mesh."""
    problem, number, cuts = plan.problem, holding.channel.number, cuts_of_rows(holding)
    reference = rows_of(holding, mesh)
    end = ending_of(
        problem,
        plan.schwarz,
        records,
        plan.tolerance,
        nested=plan.nested,
        folded=not records[-1].min_jacobian > 0.0,
    )
    begin = reference.rows.begin
    own = slice(cuts[number] - begin, min(cuts[number + 1] + 1, problem.grid.n_xi) - begin)
    physical = map_mesh(Mesh(reference.x[own].copy(), reference.y[own].copy()), problem.domain)
    detours = end.detours
    if first is not None:
        detours = (*detours, f"A process was lost; the iteration went on from the mesh of iteration {first}.")
    return SchwarzPart(
        problem=problem,
        mode=Mode.TIGHT,
        status=end.status,
        mesh=MeshPart(
            grid=problem.grid,
            number=number,
            count=holding.channel.count,
            first=cuts[number],
            last=cuts[number + 1],
            x=physical.x,
            y=physical.y,
        ),
        reference=reference,
        newton_steps=end.newton_steps,
        residual=end.residual,
        note=" ".join(text for text in (end.note, *detours[len(end.detours) :]) if text),
        remedy=end.remedy,
        algebraic_error=end.algebraic_error,
        discretization_error=safe_discretization_error(plan.expected),
        threads=plan.threads,
        iterations=tuple(records),
        sent=tuple(sent),
        detours=detours,
        resumed=first,
    )


# A solve on a domain in blocks whose subdomains several parts hold: the first one leads, the others follow.

OWN_FIELDS = ("problem", "mesh", "reference")
"""Fields of a solution that the program which requested it has: the problem, and the mesh but for its nodes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlocksResult:
    """The result of the leading part, without the problem: the nodes of the mesh, and the fields of the solution."""

    points: Array
    """Node coordinates, shape ``(n, 2)``."""
    weights: tuple[float, float]
    """``distortion`` and ``smoothness`` of the monitor, which may have been chosen."""
    values: dict[str, Any]

    @classmethod
    def of(cls, solution: OnBlocks) -> BlocksResult:
        """The result of a solution."""
        names = [field.name for field in fields(solution) if field.name not in OWN_FIELDS]
        monitor: Any = solution.problem.monitor
        return cls(
            points=solution.mesh.points,
            weights=(monitor.distortion, monitor.smoothness),
            values={name: getattr(solution, name) for name in names},
        )

    def solution(self, problem: Problem[Blocks]) -> OnBlocks:
        """The solution of ``problem`` again."""
        if isinstance(problem.monitor, Auto):
            problem = replace(problem, monitor=problem.monitor.least_error(*self.weights))
        mesh = problem.domain.mesh.moved(self.points)
        return Solution(problem=problem, mesh=mesh, reference=mesh, **self.values)


def solve_part_of_blocks(
    channel: Channel,
    problem: Problem[Blocks],
    settings: Schwarz,
    *,
    threads: int = 1,
    observe: Callable[[Event], None] | None = None,
) -> BlocksResult | None:
    """The result in the part that leads, ``None`` in the others; every part of ``channel.count`` has to call it.

    The mesh is equal to that of :func:`equimesh.solve` with the same settings, bit for bit, on any number of parts.
    ``observe`` is called with every step, in the part that leads. The leader solves the coarse meshes and measures the
    result.
    """
    subdomains = PartSubdomains(settings=settings, channel=channel)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        if channel.number == LEADER:
            options = SolveOptions(threads=threads, observer=Announcer.of(observe))
            method, minimise = method_of(problem, settings), PartMinimiseError(schwarz=settings, channel=channel)
            shared = replace(method, minimise=minimise) if isinstance(method, Best) else minimise
            found = shared.solve(problem, Initial.NESTED, options)
            subdomains.dismiss()
            return BlocksResult.of(found)
        asked = problem.monitor
        monitor: LeastError = asked.least_error() if isinstance(asked, Auto) else asked  # type: ignore[assignment]
        monitor = monitor.on(problem.domain)
        solve = LeastErrorSolve(monitor=monitor, domain=problem.domain, threads=threads, subdomains=subdomains)
        for weights, start, first in subdomains.orders():
            solve.with_weights(weights).follow(start, first)
    return None


def plain(record: Descent) -> dict[str, Any]:
    """The numbers of a step with its share of the work and its phase, without the mesh."""
    return {**record.numbers(), "fraction": record.fraction, "phase": record.phase}


def cuts_of_rows(holding: OnChannel) -> list[int]:
    """The first row of every part, and the number of rows: of strips those that their part owns, else near equal."""
    n_xi, count = holding.decomposition.grid.n_xi, holding.channel.count
    if holding.decomposition.subdomains[1] > 1:
        return [n_xi * part // count for part in range(count + 1)]
    firsts = [holding.decomposition.parts[holding.held_by(part)[0]].spans[0].owned_first for part in range(count)]
    return [*firsts, n_xi]


def rows_of(holding: OnChannel, mesh: Mesh) -> MeshRows:
    """The rows of this part of a merged mesh, and one more each way."""
    grid, cuts = holding.decomposition.grid, cuts_of_rows(holding)
    spans = with_halos(cuts)
    begin, end = spans[holding.channel.number]
    x, y = np.empty((2, end - begin, grid.n_eta))
    for k, window in enumerate(holding.patches):
        state = holding.view(mesh, k) if k in holding.numbers else None
        for part, span in enumerate(spans):
            place = common(window.part.owned, (slice(*span), slice(0, grid.n_eta)))
            if place is None:
                continue
            nodes = holding.move(holding.holder_of(k), part, holding.cut_from(state, window, place), "rows")
            if nodes is not None:
                local = moved(place, (begin, 0))
                x[local], y[local] = nodes
    first, last = cuts[holding.channel.number : holding.channel.number + 2]
    rows = Rows(shape=grid.shape, begin=begin, end=end, first=first, last=min(last, grid.n_xi - 1))
    return MeshRows(x, y, rows)
