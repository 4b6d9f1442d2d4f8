"""One function on many workers at the same time: its parts send arrays to each other, and results stay where they are.

It is the only way in which equimesh uses a cluster for one computation. A part is one long task, pinned to its worker.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Any, TypeAlias

from distributed import Client, Future

from equimesh_cluster.attempt import Attempt, Lost
from equimesh_cluster.connection import check_client
from equimesh_cluster.errors import ClusterError, RunCancelledError, WorkersLostError
from equimesh_cluster.leases import leases_of
from equimesh_cluster.placement import place
from equimesh_cluster.worker_facts import WorkerFacts, examine_scheduler, examine_workers

# How often a run is begun, at most.
MAX_ATTEMPTS = 3

ArgumentsOfPart: TypeAlias = Callable[[int, int], tuple[Any, ...]]
"""The arguments of a part, from its number and the count; they may be or hold futures. Called in every attempt."""


@dataclass(frozen=True)
class PartsRun:
    """The results of a run: one finished future for each part, whose result stays on its worker.

    ``workers`` are the addresses of the parts' workers, ``attempts`` how often the run was begun, and ``lost`` the
    workers that were lost meanwhile. The results are on the workers as long as the futures exist.
    """

    futures: tuple[Future[Any], ...]
    workers: tuple[str, ...]
    attempts: int
    lost: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of :func:`run_parts`."""

    observe: Callable[[int, Any], None] | None = None
    """Called with the number of a part and what it reports, in the caller's thread."""
    cancel: Event | None = None
    """Set it from another thread to end the run."""
    attempts: int = MAX_ATTEMPTS
    """How often the run is begun at most, where workers are lost."""
    check_workers: Callable[[list[WorkerFacts]], None] | None = None
    """Called with the worker of each part before every attempt; what it raises refuses the run."""

    def before(self, places: list[WorkerFacts]) -> None:
        """Look at the workers before an attempt."""
        if self.check_workers is not None:
            self.check_workers(places)

    def report(self, number: int, value: Any) -> None:
        """Hand a report to the observer, if there is one."""
        if self.observe is not None:
            self.observe(number, value)

    def check(self) -> None:
        """Raise :class:`~equimesh_cluster.errors.RunCancelledError` where the caller has ended the run."""
        if self.cancel is not None and self.cancel.is_set():
            raise RunCancelledError("the run was cancelled")


def run_parts(
    client: Client,
    function: Callable[..., Any],
    arguments_of_part: ArgumentsOfPart,
    *,
    parts: int | None = None,
    workers: Collection[str] | None = None,
    options: RunOptions | None = None,
) -> PartsRun:
    """``function(channel, *arguments)`` on ``parts`` parts at the same time.

    ``channel`` is a :class:`~equimesh_cluster.channel.WorkerChannel`; ``arguments_of_part(number, count)`` gives the
    arguments. The default of ``parts`` is one for each worker; more than that take the threads of a worker, one each.
    ``workers`` are the addresses to choose from, by default all.

    Where a worker is lost, the run begins again on those left, with fewer parts if they have too few threads. Raises
    the error of a part that failed by itself; :class:`~equimesh.errors.InputError` for more parts than threads;
    :class:`~equimesh_cluster.errors.WorkersLostError` where workers were lost in all attempts;
    :class:`~equimesh_cluster.errors.RunCancelledError` where the caller ended it; and
    :class:`~equimesh_cluster.errors.ClusterError` without a scheduler, or for workers with other versions.
    """
    chosen = options or RunOptions()
    examine_scheduler(check_client(client))
    lost: list[str] = []
    for attempt in range(1, chosen.attempts + 1):
        found = examine_workers(client, workers)
        if attempt == 1 and not found:
            raise ClusterError("the cluster has no workers: start some with `dask worker ADDRESS`")
        if not found:
            break
        places = place(_count(parts, found, again=attempt > 1), found)
        chosen.before(places)
        outcome = _attempt(client, function, arguments_of_part, places, chosen)
        if not isinstance(outcome, Lost):
            return PartsRun(outcome, tuple(worker.address for worker in places), attempt, tuple(lost))
        lost += outcome.workers
        reason = outcome.reason
    else:
        raise WorkersLostError(
            f"given up after {chosen.attempts} attempts ({reason}). Workers that end without a message have often run"
            " out of memory: look into their logs, and take more workers or more parts",
            lost=tuple(lost),
        )
    raise WorkersLostError(f"no worker is left; lost: {', '.join(lost)}. Start workers again", lost=tuple(lost))


def run_at(
    client: Client,
    function: Callable[..., Any],
    arguments_of_part: ArgumentsOfPart,
    workers: Sequence[str],
    *,
    options: RunOptions | None = None,
) -> PartsRun:
    """As :func:`run_parts`, part k on the worker at ``workers[k]``, which has what it needs: there is one attempt.

    Raises :class:`~equimesh_cluster.errors.WorkersLostError` where one of the workers is lost.
    """
    chosen = options or RunOptions()
    check_client(client)
    found = {worker.address: worker for worker in examine_workers(client, set(workers))}
    missing = tuple(sorted(set(workers) - set(found)))
    if missing:
        raise WorkersLostError(f"lost: {', '.join(missing)}", lost=missing)
    places = [found[address] for address in workers]
    chosen.before(places)
    outcome = _attempt(client, function, arguments_of_part, places, chosen)
    if isinstance(outcome, Lost):
        raise WorkersLostError(outcome.reason, lost=outcome.workers)
    return PartsRun(outcome, tuple(workers), 1)


def _attempt(
    client: Client,
    function: Callable[..., Any],
    arguments_of_part: ArgumentsOfPart,
    places: list[WorkerFacts],
    options: RunOptions,
) -> tuple[Future[Any], ...] | Lost:
    """The finished futures of one attempt, or what was lost."""
    try:
        with leases_of(client, [worker.address for worker in places], options.check):
            return Attempt(client, places, options.check).results(function, arguments_of_part, options.report)
    except WorkersLostError as error:
        return Lost(error.lost, str(error))


def _count(parts: int | None, workers: list[WorkerFacts], *, again: bool) -> int:
    """The number of parts: the requested one, or one for each worker; in a further attempt at most all threads."""
    if parts is None:
        return len(workers)
    return min(parts, sum(worker.threads for worker in workers)) if again else parts
