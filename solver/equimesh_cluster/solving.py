"""One mesh of a grid or of blocks on the workers of a cluster."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from distributed import Client

from equimesh.blocks.blocks import Blocks
from equimesh.equations.problem import Problem, in_blocks
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.least_error.descent import Descent
from equimesh.meshes.mesh import Grid
from equimesh.meshes.nested import nested_grids
from equimesh.monitors.least_error import LeastError
from equimesh.numerics.threads import thread_count
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.level import Mode, Step
from equimesh.solving.solution import OnBlocks, SolveError
from equimesh.solving.solve import count_subdomains
from equimesh.solving.status import Event, approach, level_share
from equimesh_cluster.connection import check_client, connect, sent
from equimesh_cluster.handle import Handle, PartsError
from equimesh_cluster.parts.part_solution import PartSolution, PartStep
from equimesh_cluster.parts.schwarz import BlocksResult, plain, solve_part_of_blocks
from equimesh_cluster.parts.solve import (
    CoarseSolution,
    OtherGridsNeededError,
    coarse_solution,
    most_parts,
    require_metric,
    solve_part,
)
from equimesh_cluster.run import PartsRun, RunOptions, run_parts
from equimesh_cluster.schwarz import SchwarzOptions, iterate
from equimesh_cluster.workers import WorkerFacts, check_memory, count_of_parts, examine_workers, place

# What a running solve tells its observer: one record for each sweep, from the records of all parts.


@dataclass(frozen=True, kw_only=True)
class Progress:
    """One step of a solve on a cluster.

    ``level`` counts from 0 to ``levels - 1``, the requested grid. The coarse levels are solved by one worker, so
    ``parts`` is 1 there and nothing is sent. ``messages`` and ``bytes`` are those that all parts sent since the record
    before. ``attempt`` is 2 or 3 after workers were lost; the parts then begin again. ``fraction`` is the share of the
    work that is done, 0 to 1, or None where it is not known, and ``phase`` says what is being done.
    """

    level: int
    levels: int
    grid: Grid
    step: int
    residual: float
    parts: int = 1
    messages: int = 0
    bytes: int = 0
    attempt: int = 1
    fraction: float | None = None
    phase: str = ""


USUAL_SWEEPS = 6
"""Sweeps that a grid usually takes."""

Observer: TypeAlias = Callable[[Progress], None]


def coarse_progress(step: Step, levels: int) -> Progress:
    """The record of a step on a level that one worker solves; ``levels`` is the number of levels of the whole solve."""
    is_relaxed = not step.relaxation.is_none
    return Progress(
        level=step.level,
        levels=levels,
        grid=step.grid,
        step=step.step,
        residual=step.residual,
        fraction=None if is_relaxed else _share(step.level, levels, step.step),
        phase=f"relaxing, step {step.step}" if is_relaxed else f"sweeping the {step.grid} grid",
    )


def _share(level: int, levels: int, step: int) -> float:
    """The share of all grids that is done after a sweep on one of them."""
    return level_share(level, levels, approach(step, USUAL_SWEEPS))


class PartsProgress:
    """Collects the records of the parts, and observes one record when all parts have sent theirs."""

    def __init__(self, observe: Observer | None) -> None:
        self._observe = observe
        self._count, self._attempt, self._done = 0, 0, 0.0
        self._waiting: dict[int, list[PartStep]] = {}

    def begin(self, count: int) -> None:
        """Begin an attempt with ``count`` parts."""
        self._count, self._attempt, self._waiting = count, self._attempt + 1, {}

    def add(self, number: int, record: PartStep) -> None:
        """Take the next record of part ``number``."""
        self._waiting.setdefault(number, []).append(record)
        while len(self._waiting) == self._count and all(self._waiting.values()):
            self._tell([self._waiting[k].pop(0) for k in range(self._count)])

    def _tell(self, records: list[PartStep]) -> None:
        """Observe the records of all parts as one."""
        if self._observe is None:
            return
        first = records[0]
        self._done = max(self._done, _share(first.level, first.levels, first.step))
        sent = [traffic for record in records for traffic in record.traffic.values()]
        self._observe(
            Progress(
                level=first.level,
                levels=first.levels,
                grid=first.grid,
                step=first.step,
                residual=first.residual,
                parts=self._count,
                messages=sum(traffic.messages for traffic in sent),
                bytes=sum(traffic.bytes for traffic in sent),
                attempt=self._attempt,
                fraction=self._done,
                phase=f"sweeping the {first.grid} grid in {self._count} parts",
            )
        )


# The mesh of a domain in blocks by the workers of a cluster: one block, or a group of blocks, a subdomain.


def solve_blocks(
    problem: Problem[Blocks],
    client: Client | str,
    schwarz: Schwarz | None = None,
    *,
    parts: int | None = None,
    threads: int = 1,
    observe: Callable[[dict[str, Any]], None] | None = None,
    cancel: threading.Event | None = None,
) -> OnBlocks:
    """The mesh of ``problem``, with its subdomains on ``parts`` workers; equal to the mesh of :func:`equimesh.solve`.

    ``client`` is a client of Dask, or the address of a scheduler. ``schwarz`` are the settings, by default one
    subdomain for each block. ``parts`` is by default one for each worker, and at most one for each subdomain; the mesh
    does not depend on it. ``threads`` share the subdomains of each part. ``observe`` is called with the numbers of
    every step; ``cancel`` ends the solve when it is set. Workers share the work on the finest mesh, and each of them
    holds the whole mesh.

    Raises :class:`~equimesh.errors.InputError` for more parts than subdomains or threads of the workers,
    :class:`~equimesh.solving.solution.SolveError` for a folded mesh, and the errors of :func:`equimesh_cluster.solve`.
    """
    if not (isinstance(problem, Problem) and in_blocks(problem)):
        raise InputError(
            "the problem has no domain in blocks: give em.Problem(..., domain=em.Blocks.of(...)), or take"
            " equimesh_cluster.solve",
            field="problem",
        )
    settings, shared = schwarz or Schwarz(), thread_count(threads)
    subdomains = count_subdomains(problem, settings)
    own = isinstance(client, str)
    connected = connect(client) if isinstance(client, str) else check_client(client)
    try:
        count = count_of_parts(connected, parts, subdomains, "every part needs a subdomain")
        found = _run(problem, connected, settings, count, shared, RunOptions(observe=_telling(observe), cancel=cancel))
    finally:
        if own:
            connected.close()
    solution = found.solution(problem)
    if not solution.status.succeeded:
        raise SolveError(solution.message, solution)
    return solution


def _telling(observe: Callable[[dict[str, Any]], None] | None) -> Callable[[int, Any], None] | None:
    if observe is None:
        return None
    told = observe
    return lambda _, numbers: told(numbers)


def _run(
    problem: Problem[Blocks], client: Client, settings: Schwarz, count: int, threads: int, options: RunOptions
) -> BlocksResult:
    """The result of the part that leads; nothing is left on the workers."""
    shared: list[Any] = []

    def arguments(number: int, _: int) -> tuple[Any, ...]:
        if number == 0:
            shared[:] = [sent(client, problem)]
        return shared[0], settings, threads, options.observe is not None

    run = run_parts(client, part_of_blocks, arguments, parts=count, options=options)
    found: BlocksResult = run.futures[0].result()
    for future in run.futures:
        future.release()
    return found


def part_of_blocks(
    channel: Any, problem: Problem[Blocks], settings: Schwarz, threads: int, tells: bool
) -> BlocksResult | None:
    """One part of the solve. Runs on its worker."""

    def observe(event: Any) -> None:
        if isinstance(event, Descent):
            channel.report(plain(event))

    return solve_part_of_blocks(channel, problem, settings, threads=threads, observe=observe if tells else None)


def solve(
    problem: Problem,
    client: Client | str,
    *,
    schwarz: Schwarz | None = None,
    parts: int | None = None,
    mode: Mode = Mode.DISCRETIZATION,
    allow_relaxed: bool = True,
    threads: int = 1,
    observe: Callable[[Any], None] | None = None,
    cancel: threading.Event | None = None,
) -> Handle:
    """The mesh of ``problem`` in ``parts`` parts, which stay on the workers; equal to :func:`equimesh.solve`.

    ``client`` is a client of Dask, or the address of a scheduler. ``parts`` is by default one for each worker; a worker
    takes as many as it has threads. ``threads`` share the rows of each part. ``mode`` and ``allow_relaxed`` are those
    of :func:`equimesh.solve`. ``observe`` is called with a :class:`~equimesh_cluster.solving.Progress` after each
    step; ``cancel`` ends the solve when it is set, with :class:`~equimesh_cluster.errors.RunCancelledError`.

    With ``schwarz`` the subdomains of a Schwarz iteration are on the workers, and a
    :class:`~equimesh_cluster.schwarz.SchwarzHandle` is returned. ``observe`` is then called with the record of every
    iteration. ``mode`` and ``allow_relaxed`` do not matter.

    Raises :class:`~equimesh.errors.InputError` for more parts than the grid or the workers can have;
    :class:`~equimesh_cluster.handle.PartsError` where the mesh is not the requested one;
    :class:`~equimesh_cluster.errors.WorkersLostError` where workers were lost in three attempts; and
    :class:`~equimesh_cluster.errors.ClusterError` without a scheduler or workers, for other versions there, and for too
    little memory.
    """
    chosen = _Settings(
        problem=_checked(problem),
        mode=choice(Mode, mode, "mode"),
        allow_relaxed=allow_relaxed,
        threads=_threads(threads),
        observe=_observer(observe),
        cancel=cancel,
    )
    if schwarz is None:
        require_metric(problem)
    elif isinstance(problem.monitor, LeastError):
        raise InputError(
            "subdomains of a grid descend on the error on one machine: take equimesh.solve, or a domain in blocks and"
            " equimesh_cluster.solve_blocks",
            field="monitor",
        )
    own = isinstance(client, str)
    connected = connect(client) if isinstance(client, str) else client
    try:
        if schwarz is not None:
            options = SchwarzOptions(parts=parts, threads=threads, observe=observe, cancel=cancel)
            handle: Handle = iterate(problem, check_client(connected), schwarz, options, own_client=own)
        else:
            handle = Handle(problem, connected, _solve(chosen, connected, parts), own_client=own)
    except BaseException:
        if own:
            connected.close()
        raise
    if not handle.status.succeeded:
        raise PartsError(handle.message, handle)
    return handle


@dataclass(frozen=True, kw_only=True)
class _Settings:
    """The arguments of a solve, checked."""

    problem: Problem
    mode: Mode
    allow_relaxed: bool
    threads: int
    observe: Observer | None
    cancel: threading.Event | None


def _checked(problem: object) -> Problem:
    if not isinstance(problem, Problem):
        raise InputError(f"problem = {str(problem)[:40]!r} is no problem: give em.Problem(...)", field="problem")
    return problem


def _threads(threads: object) -> int:
    """The threads of a part; the cores of this machine do not say how many a worker has."""
    if threads is None:
        raise InputError("threads = None: a whole number, of the threads that share each part", field="threads")
    return thread_count(threads)  # type: ignore[arg-type]


def _observer(observe: object) -> Callable[[Any], None] | None:
    if observe is not None and not callable(observe):
        raise InputError(f"observe = {str(observe)[:40]!r} is no function: give one of a Progress", field="observe")
    return observe


FINER_GRID = "the grids of this solve cannot be cut into more"
"""The reason why there are no more parts, and the remedy."""


def _solve(chosen: _Settings, client: Client, parts: int | None) -> PartsRun:
    """The parts, on the nested grids of the problem, or on others where sweeps have no solution on these."""
    _require_room(chosen.problem, client, parts)
    try:
        return _parts(chosen, client, _coarse(chosen, client, square=False), parts)
    except OtherGridsNeededError:
        return _parts(chosen, client, _coarse(chosen, client, square=True), parts)


def _require_room(problem: Problem, client: Client, parts: int | None) -> None:
    """Refuse too many parts, and workers with too few threads or too little memory, before anything is computed."""
    workers = examine_workers(check_client(client))
    if workers:
        check_memory(problem, place(count_of_parts(client, parts, most_parts(problem), FINER_GRID), workers))


def _coarse(chosen: _Settings, client: Client, *, square: bool) -> CoarseSolution:
    """The coarse solution, computed by one worker, so that the driver may be a small machine; the driver keeps it."""

    def observe(_: int, record: Any) -> None:
        if chosen.observe is not None:
            chosen.observe(record)

    def arguments(_: int, __: int) -> tuple[Any, ...]:
        return sent(client, chosen.problem), chosen.mode, chosen.allow_relaxed, chosen.threads, square

    options = RunOptions(observe=observe, cancel=chosen.cancel)
    run = run_parts(client, coarse_part, arguments, parts=1, options=options)
    found: CoarseSolution = run.futures[0].result()
    return found


def _parts(chosen: _Settings, client: Client, coarse: CoarseSolution, parts: int | None) -> PartsRun:
    """The parts, which begin with the coarse solution in every attempt."""
    count = count_of_parts(client, parts, coarse.most_parts, FINER_GRID)
    gathering = PartsProgress(chosen.observe)
    shared: list[Any] = []

    def arguments(number: int, count: int) -> tuple[Any, ...]:
        if number == 0:
            gathering.begin(count)
            shared[:] = [sent(client, chosen.problem)]
        return shared[0], sent(client, coarse.for_part(number, count)), chosen.threads

    def check(places: list[WorkerFacts]) -> None:
        check_memory(chosen.problem, places)

    options = RunOptions(observe=gathering.add, cancel=chosen.cancel, check_workers=check)
    return run_parts(client, part_of_solution, arguments, parts=count, options=options)


def coarse_part(
    channel: Any, problem: Problem, mode: Mode, allow_relaxed: bool, threads: int, square: bool
) -> CoarseSolution:
    """The coarse solution of ``problem``. Runs on a worker."""
    levels = len(nested_grids(problem.grid))

    def observe(event: Event) -> None:
        if isinstance(event, Step):
            channel.report(coarse_progress(event, levels))

    return coarse_solution(
        problem, mode=mode, allow_relaxed=allow_relaxed, threads=threads, observe=observe, square=square
    )


def part_of_solution(channel: Any, problem: Problem, coarse: CoarseSolution, threads: int) -> PartSolution:
    """One part of the solution of ``problem``. Runs on its worker."""
    return solve_part(problem, coarse, channel, threads=threads, observe=channel.report)
