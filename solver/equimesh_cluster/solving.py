"""One mesh on the workers of a cluster: the coarse solution by one of them, the finer levels in parts by all."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from distributed import Client

from equimesh.equations.problem import Problem
from equimesh.errors import InputError
from equimesh.inputs import choice
from equimesh.meshes.grid import Grid
from equimesh.meshes.nested import nested_grids
from equimesh.numerics.threads import thread_count
from equimesh.schwarz.settings import Schwarz
from equimesh.single_domain.steps import Mode, Step
from equimesh.solving.announcer import Event
from equimesh_cluster.connection import check_client, connect
from equimesh_cluster.handle import Handle, PartsError
from equimesh_cluster.inputs import sent
from equimesh_cluster.memory import check_memory
from equimesh_cluster.parts.coarse import (
    CoarseSolution,
    OtherGridsNeededError,
    coarse_solution,
    most_parts,
    require_metric,
)
from equimesh_cluster.parts.part_solution import PartSolution
from equimesh_cluster.parts.solve import solve_part
from equimesh_cluster.placement import place, require_count
from equimesh_cluster.progress import Gathering, Observer, coarse_progress
from equimesh_cluster.run import PartsRun, RunOptions, run_parts
from equimesh_cluster.schwarz import SchwarzOptions, iterate
from equimesh_cluster.worker_facts import WorkerFacts, examine_workers


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
    of :func:`equimesh.solve`. ``observe`` is called with a :class:`~equimesh_cluster.progress.Progress` after each
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
        count = _count(problem.grid, most_parts(problem), len(workers), parts)
        check_memory(problem, place(count, workers))


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
    count = _count(chosen.problem.grid, coarse.most_parts, len(client.nthreads()), parts)
    gathering = Gathering(chosen.observe)
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


def _count(grid: Grid, most: int, workers: int, parts: int | None) -> int:
    """The number of parts: by default one for each worker, and not more than the grids can be cut into."""
    if parts is None:
        return max(1, min(most, workers))
    require_count(parts)
    if parts > most:
        raise InputError(
            f"parts = {parts}: the grids of a solve with {grid} points can be cut into at most {most}: take 1 to {most}"
            " parts, or a finer grid",
            field="parts",
        )
    return parts


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
