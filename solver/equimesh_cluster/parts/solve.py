"""One part of a mesh: the coarse solution of the whole, then the sweeps of the part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from equimesh.domains.domain import Domain, Rectangle, is_closed, map_mesh
from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.meshes.mesh import Grid, Mesh, MeshRows
from equimesh.meshes.nested import nested_grids, rows_needed, square_grids
from equimesh.meshes.rows import strips_of
from equimesh.monitors.least_error import Auto, LeastError, NodalSolution
from equimesh.monitors.monitor import map_of, orthogonality_of
from equimesh.numerics.threads import run_on_threads, thread_count
from equimesh.single_domain.iteration import Climb
from equimesh.single_domain.level import MAX_RELAXED_POINTS, LevelSolution, Mode, Step, Steps
from equimesh.solving.single_domain import is_lost_in_rounding, outcome, solution_lost_in_rounding, solution_of
from equimesh.solving.solution import SolveError
from equimesh.solving.status import SolveOptions
from equimesh_cluster.mesh_part import MeshPart
from equimesh_cluster.messages import Channel, Counted
from equimesh_cluster.parts.part_solution import PartSolution, PartStep
from equimesh_cluster.parts.rows import PartRows, rows_here
from equimesh_cluster.parts.sweeps import PartClimb

# The coarse solution: the levels of the nested iteration that one process solves whole, before the parts begin.

CoarseObserver: TypeAlias = Callable[[Step], None]

# Points of the coarse solution, at most: it is computed by one process.
MAX_COARSE_POINTS = 1025 * 1025


class OtherGridsNeededError(Exception):
    """The sweeps of the parts have no solution on these nested grids.

    Begin again with the coarse solution of ``square=True``: with grids of like numbers of points in both directions.
    Only grids of other shapes raise it, and never twice.
    """


@dataclass(frozen=True, kw_only=True, eq=False)
class CoarseSolution:
    """The solution on the finest nested grid that is solved whole, and the one on the grid below it.

    It can be pickled, and sent to every part. Every attempt to compute the parts begins with it.
    """

    grids: tuple[Grid, ...]
    """All nested grids, from coarse to fine; the last one is the requested grid."""
    solved: tuple[LevelSolution, ...]
    """The last two levels that are solved."""
    mode: Mode
    allow_relaxed: bool
    only_requested: bool
    """Whether other nested grids are to be tried where sweeps have no solution of the requested equations."""

    @property
    def grid(self) -> Grid:
        """The grid of the coarse solution."""
        return self.last.grid

    @property
    def last(self) -> Step:
        """The last step on the coarse grid."""
        return self.solved[-1].step

    @property
    def level(self) -> int:
        """The number of the coarse grid among all nested grids."""
        return self.last.level

    @property
    def most_parts(self) -> int:
        """The largest number of parts into which every finer grid can be cut."""
        return _most_parts(self.grids, self.level)

    def for_part(self, number: int, count: int) -> CoarseSolution:
        """The rows of the coarse solution that part ``number`` of ``count`` needs: fewer, to send less."""
        own, *below = _rows_wanted(self.grids, self.level, number, count)
        kept = [own, *below][: len(self.solved)]
        windows = [level.mesh.within(*rows) for level, rows in zip(reversed(self.solved), kept, strict=True)]
        fewer = [
            LevelSolution(replace(level.step, mesh=Mesh(window.x, window.y)), window)
            for level, window in zip(self.solved, reversed(windows), strict=True)
        ]
        return replace(self, solved=tuple(fewer))


def _rows_wanted(grids: Sequence[Grid], level: int, number: int, count: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """The rows of a level that a part needs for two finer levels, and the rows of the coarser level for the first."""
    coarse, finer = grids[level].n_xi, grids[level + 1 : level + 3]
    if not finer:
        return rows_here(grids[level].shape, count)[number], (0, grids[max(level - 1, 0)].n_xi)
    first = rows_needed(coarse, finer[0].n_xi, rows_here(finer[0].shape, count)[number])
    below = rows_needed(grids[level - 1].n_xi, coarse, first) if level > 0 else (0, coarse)
    if len(finer) == 1:
        return first, below
    between = rows_needed(finer[0].n_xi, finer[1].n_xi, rows_here(finer[1].shape, count)[number])
    second = rows_needed(coarse, finer[0].n_xi, between)
    return (min(first[0], second[0]), max(first[1], second[1])), below


def most_parts(problem: Problem, max_points: int = MAX_COARSE_POINTS) -> int:
    """The largest number of parts that the grids of ``problem`` can be cut into, before there is a coarse solution."""
    grids = nested_grids(problem.grid)
    return _most_parts(grids, _coarse_level(grids, max_points))


def _most_parts(grids: Sequence[Grid], level: int) -> int:
    return min(len(strips_of(grid.shape)) for grid in grids[level + 1 :] or grids[-1:])


def coarse_solution(
    problem: Problem,
    *,
    mode: Mode = Mode.DISCRETIZATION,
    allow_relaxed: bool = True,
    threads: int | None = None,
    observe: CoarseObserver | None = None,
    max_points: int = MAX_COARSE_POINTS,
    square: bool = False,
) -> CoarseSolution:
    """The coarse solution of ``problem``, on at most ``max_points`` points, by one process.

    ``square`` takes grids of like numbers of points in both directions, after :class:`OtherGridsNeededError`. Raises
    :class:`~equimesh.errors.InputError` for a monitor that has no metric, with what to take instead, and
    :class:`~equimesh.solving.solution.SolveError` where the coarse grid has no solution, or only a relaxed one and
    ``allow_relaxed`` is false.
    """
    require_metric(problem)
    mode, options = choice(Mode, mode, "mode"), SolveOptions(thread_count(threads), None)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        squares, grids = square_grids(problem.grid), nested_grids(problem.grid)
        found = None
        given = mode, options, max_points, observe
        if not square:
            only = squares != grids
            found = _solved(problem, grids, *given, allow_relaxed=allow_relaxed, only_requested=only)
        if found is None:
            found = _solved(problem, squares, *given, allow_relaxed=allow_relaxed, only_requested=False)
        if found is None:
            raise AssertionError("the last nested grids always have some solution")
        last, here = found.last, problem.on_grid(found.grid)
        if last.failed or not (last.is_exact or allow_relaxed) or last.strength == 0.0:
            solution = solution_of(last, here, options, mode, allow_relaxed=allow_relaxed)
            raise SolveError(solution.message, solution)
    return found


def _solved(
    problem: Problem,
    grids: list[Grid],
    mode: Mode,
    options: SolveOptions,
    max_points: int,
    observe: CoarseObserver | None,
    *,
    allow_relaxed: bool,
    only_requested: bool,
) -> CoarseSolution | None:
    """The levels up to the coarse grid; ``None`` as :meth:`~equimesh.single_domain.iteration.Climb.by_sweeps`."""
    level = _coarse_level(grids, max_points)
    here = problem.on_grid(grids[level])
    _require_uniform(here)
    if is_lost_in_rounding(problem):
        solution = solution_lost_in_rounding(here, None, mode)
        raise SolveError(solution.message, solution)
    climb = Climb(problem, mode, options.threads, grids)
    steps = climb.by_sweeps(only_requested=only_requested, levels=range(level + 1))
    last: Step | None = None
    while True:
        try:
            last = next(steps)
        except StopIteration as end:
            if end.value is None:
                return None
            last = end.value
            break
        if observe is not None:
            observe(last.snapshot())
    solved = climb.solved if not last.failed else [LevelSolution.of(last)]
    return CoarseSolution(
        grids=tuple(grids),
        solved=tuple(solved),
        mode=mode,
        allow_relaxed=allow_relaxed,
        only_requested=only_requested,
    )


def _coarse_level(grids: list[Grid], max_points: int) -> int:
    """The finest grid of at most ``max_points`` points that is coarser than the requested one.

    The requested grid itself where it is so coarse that relaxed equations may be solved on it.
    """
    if grids[-1].points <= min(MAX_RELAXED_POINTS, max_points):
        return len(grids) - 1
    return max([level for level, grid in enumerate(grids[:-1]) if grid.points <= max_points], default=0)


def require_metric(problem: Problem) -> None:
    """Refuse monitors without equations along mesh lines.

    Raises :class:`~equimesh.errors.InputError`, which names a monitor to take instead.
    """
    monitor, field = problem.monitor, "monitor"
    if isinstance(monitor, Auto | LeastError | NodalSolution):
        kind = {Auto: "auto", LeastError: "least_error", NodalSolution: "nodal_solution"}[type(monitor)]
        raise InputError(
            f"{kind} has no metric, and is not solved in parts: take Curvature(u=...), whose meshes have a small"
            " interpolation error, or ArcLength(u=...)",
            field=field,
        )
    require_no_seam(problem)
    if map_of(monitor) != "lines":
        raise InputError("a gradient map is not solved in parts: take map = 'lines'", field="monitor.map")
    if orthogonality_of(monitor) is not None:
        raise InputError(
            "a bound of the angles is not kept in parts: solve a grid of at most 1025 x 1025 points with the bound, and"
            " take monitor.weakened(...) with the strength that its certificate names",
            field="monitor.orthogonality",
        )


def require_no_seam(problem: Problem) -> None:
    """Refuse closed lines; raises :class:`~equimesh.errors.InputError`."""
    if is_closed(problem.domain):
        raise InputError(
            "the lines of this domain are closed, and parts end at sides: solve it as a whole, with"
            " equimesh.solve, or take a domain without closed lines",
            field="domain",
        )


def _require_uniform(problem: Problem) -> None:
    """Refuse a coarse grid with too few points for the curved sides of the domain."""
    if type(problem.domain) is not Rectangle and map_mesh(Mesh.uniform(problem.grid), problem.domain).is_folded:
        raise InputError(
            f"the uniform mesh of {problem.grid} points has an inverted cell on this domain: its sides curve too much"
            " for so few points; add grid points",
            field="grid",
        )


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
    :class:`~equimesh_cluster.parts.solve.OtherGridsNeededError`, and :class:`~equimesh_cluster.messages.PeerError`.
    """
    if channel.count > coarse.most_parts:
        raise InputError(
            f"parts = {channel.count}: the grids of this solve can be cut into at most {coarse.most_parts} parts",
            field="parts",
        )
    counted, first = Counted(channel), coarse.level + 1
    rows = PartRows.of(problem.grid.shape, threads, counted)
    with np.errstate(all="ignore"):  # values that are not finite are detected where they matter
        last, records = coarse.last, list[PartStep]()
        if first < len(coarse.grids):
            climb = PartClimb(problem, coarse.mode, threads, coarse.grids, coarse.solved, channel=counted, first=first)
            steps = climb.by_sweeps(only_requested=coarse.only_requested, levels=range(first, len(coarse.grids)))
            last = _last_of(steps, counted, records, observe)
            reference = MeshRows(last.mesh.x, last.mesh.y, rows)
            del climb, steps
        else:
            found = coarse.solved[-1].mesh.within(rows.begin, rows.end)
            reference = MeshRows(found.x, found.y, rows)
        mesh = _mapped(reference, problem.domain)
        folded = mesh is not reference and mesh.is_folded
    return PartSolution(
        problem=problem,
        mode=coarse.mode,
        mesh=_part_of(mesh, channel),
        reference=reference.within(rows.begin, rows.end),
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


def _mapped(mesh: MeshRows, domain: Domain) -> MeshRows:
    """The rows of the mesh of the domain that are here; ``mesh`` itself where the map is the identity."""
    if isinstance(domain, Rectangle) and domain.is_unit_square:
        return mesh
    x, y = np.empty(mesh.x.shape), np.empty(mesh.y.shape)
    rows = max(1, MAX_MAPPED_NODES // mesh.grid.n_eta)
    blocks, threads = [slice(row, row + rows) for row in range(0, len(x), rows)], len(mesh.rows.shares)

    def work(number: int) -> None:
        for block in blocks[number::threads]:
            x[block], y[block] = domain.map(mesh.x[block], mesh.y[block])

    run_on_threads(threads, work)
    return MeshRows(x, y, mesh.rows)


def _part_of(mesh: MeshRows, channel: Channel) -> MeshPart:
    """The own rows of a mesh, and the first one of the next part."""
    own, begin, n_xi = mesh.rows.own_nodes, mesh.rows.begin, mesh.grid.n_xi
    first, last = begin + own.start, begin + own.stop
    found = mesh.within(first, min(last + 1, n_xi))
    number, count = channel.number, channel.count
    return MeshPart(grid=mesh.grid, number=number, count=count, first=first, last=last, x=found.x, y=found.y)
