"""One function on many workers whose parts talk to each other: attempts, and what is lost with a worker.

It is the only way in which equimesh uses a cluster for one computation. A part is one long task, pinned to its worker.
"""

from __future__ import annotations

import asyncio
import queue
import time
import uuid
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from threading import Event
from typing import Any, TypeAlias

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from equimesh_cluster.channel import END, Seat, listening, run_part
from equimesh_cluster.connection import check_client, leases_of, no_scheduler
from equimesh_cluster.errors import ClusterError, RunCancelledError, WorkersLostError
from equimesh_cluster.messages import PeerError
from equimesh_cluster.workers import WorkerFacts, examine_scheduler, examine_workers, place

# One attempt of a run: a pinned task for each part, watched until all are done or one of them is lost.

# Seconds between two looks at the workers, and at whether the run was cancelled.
LOOK_SECONDS = 0.25
# Seconds in which the parts of a run that has ended stop: each looks when it next sends or receives.
MAX_END_SECONDS = 60.0
PRIORITY = 10
"""Parts go before other tasks that wait for the same worker: their peers wait for them."""


@dataclass(frozen=True)
class AttemptFailure:
    """The reason why an attempt ended early, and the workers that were lost.

    Without lost workers a part failed by itself.
    """

    workers: tuple[str, ...]
    reason: str


class Attempt:
    """The parts of one attempt, each on its worker."""

    def __init__(self, client: Client, places: Sequence[WorkerFacts], check: Callable[[], None]) -> None:
        self._client, self._places, self._check = client, places, check
        self._run = uuid.uuid4().hex
        self._addresses = tuple(worker.address for worker in places)
        self._events: queue.Queue[tuple[str, int, Any]] = queue.Queue()
        self._futures: list[Future[Any]] = []

    def results(
        self,
        function: Callable[..., Any],
        arguments_of_part: Callable[[int, int], tuple[Any, ...]],
        observe: Callable[[int, Any], None],
    ) -> tuple[Future[Any], ...] | AttemptFailure:
        """The finished futures of all parts, or what was lost.

        Raises the error of the first part that failed by itself, and whatever ``observe`` and ``check`` raise. Nothing
        of the attempt is left on the workers then.
        """
        done = False
        with listening(self._client, self._run, lambda number, value: self._events.put(("report", number, value))):
            try:
                self._submit(function, arguments_of_part)
                lost = self._watch(observe)
                if lost is not None:
                    self._end(lost.reason, failed=not lost.workers)
                self._raise_own_error()
                if lost is not None:
                    return lost
                self._let_go()
                done = True
                return tuple(self._futures)
            except (OSError, asyncio.CancelledError, AttributeError) as error:  # a closed client has no scheduler
                if self._client.status != "running":
                    raise no_scheduler(self._client) from error
                raise
            finally:
                if not done:
                    self._abandon()

    def _submit(self, function: Callable[..., Any], arguments_of_part: Callable[[int, int], tuple[Any, ...]]) -> None:
        """One task for each part, pinned to its worker."""
        count = len(self._places)
        for number, worker in enumerate(self._places):
            key = f"equimesh-part-{self._run}-{number}"
            seat = Seat(run=self._run, number=number, addresses=self._addresses, identity=worker.identity, key=key)
            future = self._client.submit(
                run_part,
                seat,
                function,
                arguments_of_part(number, count),
                key=key,
                workers=[worker.address],
                allow_other_workers=False,
                retries=0,
                pure=False,
                priority=PRIORITY,
            )
            self._futures.append(future)
            future.add_done_callback(lambda _, number=number: self._events.put(("done", number, None)))

    def _watch(self, observe: Callable[[int, Any], None]) -> AttemptFailure | None:
        """Wait for all parts; returns the failure as soon as there is one."""
        left = set(range(len(self._futures)))
        looked = time.monotonic()
        while left:
            self._check()
            try:
                kind, number, value = self._events.get(timeout=LOOK_SECONDS)
            except queue.Empty:
                kind, number, value = "", 0, None
            if kind == "report":
                observe(number, value)
            elif kind == "done":
                left.discard(number)
                if self._futures[number].status != "finished":
                    return AttemptFailure(self._missing(), self._failure(number))
            if time.monotonic() - looked > LOOK_SECONDS:
                looked = time.monotonic()
                if missing := self._missing():
                    return AttemptFailure(missing, f"lost: {', '.join(missing)}")
        return self._rest(observe)

    def _rest(self, observe: Callable[[int, Any], None]) -> AttemptFailure | None:
        """Pass on the last reports. Returns the failure if workers were lost before the last part ended."""
        while not self._events.empty():
            kind, number, value = self._events.get()
            if kind == "report":
                observe(number, value)
        missing = self._missing()
        return AttemptFailure(missing, f"lost: {', '.join(missing)}") if missing else None

    def _missing(self) -> tuple[str, ...]:
        """The addresses of workers that the scheduler does not know any more."""
        wanted = sorted(set(self._addresses))
        alive = self._client.nthreads(workers=wanted)
        return tuple(address for address in wanted if address not in alive)

    def _failure(self, number: int) -> str:
        """The end of a part whose future is not finished."""
        future = self._futures[number]
        cause = future.exception() if future.status == "error" else f"its task is {future.status}"
        return f"part {number} on {self._addresses[number]} failed: {cause}"

    def _end(self, reason: str, *, failed: bool) -> None:
        """Tell all parts that the run has ended, and wait until they have stopped."""
        latest = time.monotonic() + MAX_END_SECONDS
        while time.monotonic() < latest:
            alive = self._client.nthreads(workers=sorted(set(self._addresses)))
            scheduler: Any = self._client.scheduler
            message = {"op": END, "run": self._run, "reason": reason, "failed": failed}
            self._client.sync(scheduler.broadcast, msg=message, workers=list(alive), on_error="ignore")
            running = [
                future
                for future, address in zip(self._futures, self._addresses, strict=False)
                if address in alive and future.status == "pending"
            ]
            if not running:
                return
            time.sleep(LOOK_SECONDS / 5)

    def _raise_own_error(self) -> None:
        """Raise the error of the first part that failed by itself, not for what happened to another one."""
        for future in self._futures:
            if future.status == "error":
                error = future.exception()
                if error is not None and not isinstance(error, PeerError | KilledWorker):
                    raise error

    def _let_go(self) -> None:
        """Let the tasks, which are done, run on any worker: a result that is lost is an error then, for who needs it.

        A pinned task would be run again on its worker, which is gone, and would be waited for.
        """
        scheduler: Any = self._client.scheduler
        self._client.sync(scheduler.set_restrictions, worker={future.key: None for future in self._futures})

    def _abandon(self) -> None:
        """Leave nothing of the attempt on the workers."""
        if self._client.status == "running" and self._futures:
            self._end("the run was given up", failed=False)
            self._client.cancel(self._futures, force=True)
        for future in self._futures:
            future.release()
        self._futures = []


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
    """A function that is called with the number of a part and its report, in the caller's thread."""
    cancel: Event | None = None
    """An event that ends the run when another thread sets it."""
    attempts: int = MAX_ATTEMPTS
    """The largest number of attempts, where workers are lost."""
    check_workers: Callable[[list[WorkerFacts]], None] | None = None
    """A function that is called with the worker of each part before every attempt; an error from it ends the run."""

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
        if not isinstance(outcome, AttemptFailure):
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
) -> PartsRun:
    """See :func:`run_parts`, part k on the worker at ``workers[k]``, which has what it needs: there is one attempt.

    Raises :class:`~equimesh_cluster.errors.WorkersLostError` where one of the workers is lost.
    """
    check_client(client)
    found = {worker.address: worker for worker in examine_workers(client, set(workers))}
    missing = tuple(sorted(set(workers) - set(found)))
    if missing:
        raise WorkersLostError(f"lost: {', '.join(missing)}", lost=missing)
    places = [found[address] for address in workers]
    outcome = _attempt(client, function, arguments_of_part, places, RunOptions())
    if isinstance(outcome, AttemptFailure):
        raise WorkersLostError(outcome.reason, lost=outcome.workers)
    return PartsRun(outcome, tuple(workers), 1)


def _attempt(
    client: Client,
    function: Callable[..., Any],
    arguments_of_part: ArgumentsOfPart,
    places: list[WorkerFacts],
    options: RunOptions,
) -> tuple[Future[Any], ...] | AttemptFailure:
    """The finished futures of one attempt, or what was lost."""
    try:
        with leases_of(client, [worker.address for worker in places], options.check):
            return Attempt(client, places, options.check).results(function, arguments_of_part, options.report)
    except WorkersLostError as error:
        return AttemptFailure(error.lost, str(error))


def _count(parts: int | None, workers: list[WorkerFacts], *, again: bool) -> int:
    """The number of parts: the requested one, or one for each worker; in a further attempt at most all threads."""
    if parts is None:
        return len(workers)
    return min(parts, sum(worker.threads for worker in workers)) if again else parts
