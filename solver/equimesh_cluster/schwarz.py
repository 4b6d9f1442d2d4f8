"""A Schwarz iteration whose subdomains are on the workers of a cluster."""

from __future__ import annotations

import math
import uuid
import weakref
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from threading import Event, Lock
from typing import TYPE_CHECKING, Any

from distributed import Client, get_worker

from equimesh.equations.problem import Problem
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.monitor import require_lines
from equimesh.schwarz.records import Iteration, IterationNumbers
from equimesh.schwarz.settings import Schwarz
from equimesh.solving.schwarz import schwarz_reference, schwarz_start
from equimesh.solving.status import Initial, IterationProgress, SolveOptions
from equimesh_cluster.connection import sent
from equimesh_cluster.handle import Handle
from equimesh_cluster.messages import Traffic, added
from equimesh_cluster.parts.checkpoints import Checkpoints
from equimesh_cluster.parts.schwarz import SchwarzPart, SchwarzPlan, iterate_part
from equimesh_cluster.run import PartsRun, RunOptions, run_parts
from equimesh_cluster.workers import WorkerFacts, check_memory, count_of_parts, equal_rows

if TYPE_CHECKING:
    from distributed import Worker

# Bytes that a part takes for each of its points, at its peak: meshes of earlier iterations for the acceleration, memory
# of the sweeps, and the kept copies.
BYTES_A_POINT = 500
# Observers get the meshes of iterations on grids of at most this many points. The scheduler keeps 1000 reports.
MAX_SHOWN_POINTS = 65 * 65

IterationObserver = Callable[[IterationNumbers], None]

_KEPT: weakref.WeakKeyDictionary[Worker, tuple[str, Checkpoints]] = weakref.WeakKeyDictionary()
"""The copies of iterates on each worker of this process, with the name of their run: a worker is in one at a time."""
_LOCK = Lock()


@dataclass(frozen=True, kw_only=True)
class SchwarzOptions:
    """Options of :func:`iterate`, with the meaning that they have in :func:`equimesh_cluster.solve`."""

    parts: int | None = None
    """The number of parts that hold the subdomains; by default one for each worker, at most one for each subdomain."""
    threads: int = 1
    """The threads of each part, which share its subdomains."""
    initial: Initial | Mesh = Initial.NESTED
    """The start: from a coarser grid, the uniform mesh, or a mesh of the reference square."""
    observe: IterationObserver | None = None
    """Called with the record of every iteration; with its mesh on grids of at most ``MAX_SHOWN_POINTS`` points."""
    cancel: Event | None = None
    """Set it from another thread to end the run."""


class SchwarzHandle(Handle):
    """The mesh of a Schwarz iteration in strips of rows, which stay on the workers, and its records.

    ``schwarz`` are the settings. ``iterations`` are the records of all iterations, those before a loss of workers
    included; ``sent`` what all parts really sent in each of them, by the kind of the message.
    """

    def __init__(
        self, plan: SchwarzPlan, client: Client, run: PartsRun, records: list[IterationNumbers], *, own_client: bool
    ) -> None:
        super().__init__(plan.problem, client, run, own_client=own_client)
        self.schwarz, self.iterations = plan.schwarz, tuple(records)
        numbers = client.gather([client.submit(numbers_of, future, pure=False) for future in run.futures])
        self.detours: tuple[str, ...] = numbers[0][0]
        self.resumed: int | None = numbers[0][1]
        first = 0 if self.resumed is None else self.resumed + 1
        self.sent: dict[int, dict[str, Traffic]] = {}
        for k, parts in enumerate(zip(*(counts for _, _, counts in numbers), strict=True)):
            self.sent[first + k] = added(parts)

    @property
    def traffic(self) -> dict[str, Traffic]:
        """The messages that all parts sent, and their bytes, by the kind of the message."""
        return added(self.sent.values())


def iterate(
    problem: Problem, client: Client, schwarz: Schwarz, options: SchwarzOptions, *, own_client: bool = False
) -> SchwarzHandle:
    """The mesh of a Schwarz iteration with its subdomains on the workers. The iterates are the same as in one process.

    The start, and the single-domain mesh with ``compare_single_domain``, are computed here, whole. After the loss of a
    worker the iteration continues from its last iterate on the other workers. Raises as :func:`equimesh_cluster.solve`.
    """
    require_lines(problem.monitor)
    most = len(schwarz.decompose(problem.grid).parts)
    count = count_of_parts(client, options.parts, most, "every part needs a subdomain")
    plan, start, exact = _planned(problem, schwarz, options)
    name, records = uuid.uuid4().hex, list[IterationNumbers]()
    course = IterationProgress(plan.tolerance, schwarz.max_iterations)

    def add(number: int, report: dict[str, Any]) -> None:
        if number == 0:
            record = _record(problem, report)
            share, phase = course.look(record)
            record = replace(record, fraction=share, phase=phase)
            del records[record.iteration :]
            records.append(record)
            if options.observe is not None:
                options.observe(record)

    def arguments(number: int, count: int) -> tuple[Any, ...]:
        windows = [None if mesh is None else plan.windows(mesh, number, count) for mesh in (start, exact)]
        return sent(client, plan), sent(client, windows), name

    def check(places: list[WorkerFacts]) -> None:
        check_memory(problem, places, BYTES_A_POINT, equal_rows(problem.grid, len(places)))

    try:
        chosen = RunOptions(observe=add, cancel=options.cancel, check_workers=check)
        run = run_parts(client, part_of_iteration, arguments, parts=count, options=chosen)
    finally:
        if client.status == "running":
            client.run(forget, name, on_error="ignore")
    return SchwarzHandle(plan, client, run, records, own_client=own_client)


def _planned(problem: Problem, schwarz: Schwarz, options: SchwarzOptions) -> tuple[SchwarzPlan, Mesh, Mesh | None]:
    """The input of all parts, the start, and the mesh to compare with."""
    plan = SchwarzPlan(
        problem=problem,
        schwarz=schwarz,
        tolerance=None,
        expected=math.nan,
        nested=options.initial is not Initial.UNIFORM,
        threads=options.threads,
        shows=options.observe is not None and problem.grid.points <= MAX_SHOWN_POINTS,
    )
    here = SolveOptions(threads=options.threads, observer=None)
    start, tolerance, expected = schwarz_start(problem, schwarz, options.initial, here)
    exact = None
    if schwarz.compare_single_domain:
        step = schwarz_reference(problem, here)
        exact = step.mesh if step.is_exact else None
    return replace(plan, tolerance=tolerance, expected=expected), start, exact


def part_of_iteration(channel: Any, plan: SchwarzPlan, windows: list[Any], name: str) -> SchwarzPart:
    """One part of a Schwarz iteration. Runs on its worker."""

    def report(record: IterationNumbers) -> None:
        if channel.number == 0:
            channel.report(_plain(record))

    kept = kept_on(get_worker(), name)
    return iterate_part(channel, plan, windows[0], windows[1], kept=kept, observe=report)


def kept_on(worker: Worker, name: str) -> Checkpoints:
    """The copies of the iterates of a run on a worker. Copies of an earlier run, which has ended, are deleted."""
    with _LOCK:
        found = _KEPT.get(worker)
        if found is None or found[0] != name:
            found = _KEPT[worker] = name, Checkpoints()
        return found[1]


def forget(name: str, dask_worker: Worker) -> None:
    """Remove the copies of a run from a worker."""
    with _LOCK:
        if _KEPT.get(dask_worker, ("",))[0] == name:
            del _KEPT[dask_worker]


def numbers_of(part: SchwarzPart) -> tuple[tuple[str, ...], int | None, tuple[dict[str, Traffic], ...]]:
    """The detours of a part, where it went on, and what it sent. Runs where the part is."""
    return part.detours, part.resumed, part.sent


def _plain(record: IterationNumbers) -> dict[str, Any]:
    """The fields of a record without the problem, which the driver has."""
    return {field.name: getattr(record, field.name) for field in fields(record) if field.name != "problem"}


def _record(problem: Problem, report: dict[str, Any]) -> IterationNumbers:
    return Iteration(problem=problem, **report) if "mesh" in report else IterationNumbers(problem=problem, **report)
