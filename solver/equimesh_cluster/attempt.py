"""One attempt of a run: a pinned task for each part, watched until all are done or one of them is lost."""

from __future__ import annotations

import asyncio
import queue
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from distributed import Client, Future
from distributed.scheduler import KilledWorker

from equimesh.numerics.channel import PeerError
from equimesh_cluster.channel import Seat
from equimesh_cluster.connection import no_scheduler
from equimesh_cluster.messages import END
from equimesh_cluster.part_task import run_part
from equimesh_cluster.reports import listening
from equimesh_cluster.worker_facts import WorkerFacts

# Seconds between two looks at the workers, and at whether the run was cancelled.
LOOK_SECONDS = 0.25
# Seconds in which the parts of a run that has ended stop: each looks when it next sends or receives.
MAX_END_SECONDS = 60.0
PRIORITY = 10
"""Parts go before other tasks that wait for the same worker: their peers wait for them."""


@dataclass(frozen=True)
class Lost:
    """Why an attempt ended early: workers that were lost, or a part that failed, by itself or for one of those."""

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
    ) -> tuple[Future[Any], ...] | Lost:
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

    def _watch(self, observe: Callable[[int, Any], None]) -> Lost | None:
        """Wait for all parts; return what was lost, once it is."""
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
                    return Lost(self._missing(), self._failure(number))
            if time.monotonic() - looked > LOOK_SECONDS:
                looked = time.monotonic()
                if missing := self._missing():
                    return Lost(missing, f"lost: {', '.join(missing)}")
        return self._rest(observe)

    def _rest(self, observe: Callable[[int, Any], None]) -> Lost | None:
        """Hand over the last reports; return what was lost between the end of a part and that of the last one."""
        while not self._events.empty():
            kind, number, value = self._events.get()
            if kind == "report":
                observe(number, value)
        missing = self._missing()
        return Lost(missing, f"lost: {', '.join(missing)}") if missing else None

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
