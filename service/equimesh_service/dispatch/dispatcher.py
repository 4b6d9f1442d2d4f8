"""The dispatcher: takes waiting meshes to the engine, and looks after those that lost their worker."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from equimesh_service.engine.port import Engine
from equimesh_service.errors import MemoryLimitError, TimeLimitError, WorkerLostError
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_problem
from equimesh_service.store.rows import FAILED, Claim, Ending, Lease, MeshInput
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.worker.attempt import log_context_of

_log = logging.getLogger(__name__)
# Seconds; a database that is locked is waited for half as long.
_MAX_ROUND_SECONDS = 60.0
# How often a dispatcher looks whether its claims still stand; work that is for nobody ends after two looks.
_CHECK_SECONDS = 0.4
_MAX_LINE_LENGTH = 64


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The dispatcher's part of the settings; all times in seconds."""

    time_limit: float = 300.0
    memory_limit: int = 4096
    max_attempts: int = 3
    lease: float = 15.0
    poll: float = 0.2


class Dispatcher:
    """A thread between a store and an engine.

    It holds as many claims as the engine has workers, renews their leases while they run, and takes back the
    claims of owners that went silent. ``run`` is what a worker does with a claim: it writes its results into
    the store itself. ``notify`` hears the id of every mesh whose status may have changed.

    A mesh for which somebody waits need not go through the queue: :meth:`reserve` a worker, put the mesh into the
    store as claimed by :attr:`lease`, and :meth:`begin` it, or :meth:`release` the worker. Where no worker is free,
    :meth:`line_up` for one: this line and the queue take turns.
    """

    def __init__(
        self,
        owner: str,
        store: Store,
        engine: Engine,
        run: Callable[[Claim, MeshInput | None], tuple[Callable[..., Any], tuple[Any, ...]]],
        rules: Rules,
        notify: Callable[[str], None],
        metrics: Metrics | None = None,
    ) -> None:
        self._owner = owner
        self._store = store
        self._engine = engine
        self._run = run
        self._rules = rules
        self._notify = notify
        self._metrics = metrics or Metrics()
        self.lease = Lease(owner=owner, seconds=rules.lease)
        self._lock = threading.RLock()  # of the six that follow; a task may end while it is submitted
        self._running: dict[Claim, Future[Any]] = {}
        self._reserved = 0
        self._line: deque[Future[bool]] = deque()  # who waits for a worker to be reserved
        self._is_turn_of_line = False  # where somebody waits in the queue, too
        self._queue_is_empty = False  # as far as this service knows
        self._woken = False  # since the look at the queue that goes on
        self._strays: set[Claim] = set()  # claims of this service that no worker has
        self._gone: set[Claim] = set()  # what workers have that this service has no claim to
        self._ended: queue.SimpleQueue[tuple[Claim, Future[Any]]] = queue.SimpleQueue()
        self._came_round = time.monotonic()
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="equimesh-dispatcher", daemon=True)

    def start(self, *, alone: bool) -> None:
        """Begin. ``alone`` says that no other service uses this store: what is running there is left over."""
        for claim in self._store.queue.abandoned(owner_gone=self._owner if alone else None):
            self._lost(claim, "the service stopped while a worker had this mesh")
        self._thread.start()

    def wake(self) -> None:
        """Look at the queue now."""
        with self._lock:
            self._queue_is_empty, self._woken = False, True
        self._wake.set()

    def reserve(self) -> bool:
        """Keep a worker free for a mesh that is not in the store yet; False when none is, or others have waited."""
        with self._lock:
            free = self._queue_is_empty and not self._line and not self._stopping.is_set() and self._has_room()
            self._reserved += free
        return free

    def line_up(self) -> Future[bool]:
        """Wait for a worker: True when one is reserved, False when the line is too long, or the service ends."""
        turn: Future[bool] = Future()
        with self._lock:
            if len(self._line) < _MAX_LINE_LENGTH and not self._stopping.is_set():
                self._line.append(turn)
                self._call_up()
                return turn
        turn.set_result(False)
        return turn

    def step_out(self, turn: Future[bool]) -> None:
        """Leave the line; a worker that was reserved meanwhile is given up."""
        with self._lock:
            if turn in self._line:
                self._line.remove(turn)
                return
        if turn.result():
            self.release()

    def release(self) -> None:
        """Give up a reserved worker."""
        with self._lock:
            self._reserved -= 1
            self._call_up()
        self._wake.set()

    def begin(self, claim: Claim, mesh_input: MeshInput) -> Future[Any]:
        """Give a claimed mesh to the reserved worker; the future ends when the worker does."""
        with self._lock:
            task = self._submit(claim, mesh_input)
            self._reserved -= 1
            return task

    def cancel(self, mesh_id: str) -> None:
        """Stop the work on a mesh that was canceled or deleted in the store."""
        for claim, task in self._held():
            if claim.mesh_id == mesh_id:
                self._engine.cancel(task)
        self._notify(mesh_id)
        self._wake.set()

    def alive(self) -> bool:
        """Whether the thread does its work: it is there, and has come round within a minute."""
        return self._thread.is_alive() and time.monotonic() - self._came_round < _MAX_ROUND_SECONDS

    def stop(self) -> None:
        """End; meshes that are being computed go back into the queue."""
        self._stopping.set()
        self._wake.set()
        self._thread.join()
        with self._lock:
            while self._line:
                self._line.popleft().set_result(False)
        running = self._held()
        try:
            # Those, too, that had not come to a worker yet.
            for claim in self._store.queue.renew(self._owner, self._rules.lease):
                if self._store.queue.requeue(claim, "the service was stopped"):
                    _log.info("mesh %s goes back into the queue", claim.mesh_id)
        except Exception as error:  # the leases run out, and the meshes are lost then
            if storage_problem(error) is None:
                _log.exception("meshes could not be put back into the queue")
        for _, task in running:
            self._engine.cancel(task)

    def _loop(self) -> None:
        next_care = next_look = next_check = time.monotonic()
        while not self._stopping.is_set():
            self._wake.clear()
            self._came_round = time.monotonic()
            try:
                self._settle()
                if time.monotonic() >= next_care:
                    self._care()
                    next_care = time.monotonic() + self._rules.lease / 3
                if self._running and time.monotonic() >= next_check:
                    self._drop_gone()
                    next_check = time.monotonic() + _CHECK_SECONDS
                if not self._queue_is_empty or time.monotonic() >= next_look:
                    self._fill()
                    next_look = time.monotonic() + self._rules.poll  # others may have put something in
            except Exception as error:
                if storage_problem(error) is None:  # which says itself what it is
                    _log.exception("the dispatcher failed; it goes on")
                self._stopping.wait(1.0)
            self._wake.wait(self._rules.poll)

    def _fill(self) -> None:
        while self._take_room():
            self._woken = False
            try:
                claim = self._store.queue.claim(self._owner, self._rules.lease)
            except BaseException:
                self.release()
                raise
            with self._lock:  # until here it counts as what it was, so that nobody overtakes during the look
                self._reserved -= 1
                self._queue_is_empty = claim is None and not self._woken
                self._is_turn_of_line = True
                task = None if claim is None else self._submit(claim, None)
                self._call_up()  # now that the worker of the claim is not free any more
            if claim is None or task is None:
                return
            row = self._store.meshes.get(claim.mesh_id)
            if row is None or row.finished:
                self._engine.cancel(task)  # canceled between the claim and now: `cancel` did not see the task
            self._notify(claim.mesh_id)

    def _take_room(self) -> bool:
        """Reserve a worker for what may be in the queue."""
        with self._lock:
            self._call_up()
            free = self._has_room()
            self._reserved += free
        return free

    def _call_up(self) -> None:
        """Reserve workers that are free for those in the line, under the lock; in turns where others are queued."""
        while self._line and (self._queue_is_empty or self._is_turn_of_line) and self._has_room():
            self._reserved += 1
            self._is_turn_of_line = False
            self._line.popleft().set_result(True)

    def _has_room(self) -> bool:
        health = self._engine.health()
        return health.ready and len(self._running) + self._reserved < health.workers

    def _held(self) -> list[tuple[Claim, Future[Any]]]:
        with self._lock:
            return list(self._running.items())

    def _submit(self, claim: Claim, mesh_input: MeshInput | None) -> Future[Any]:
        self._metrics.began(claim.waited)
        with log_context.enter(log_context_of(claim)):
            _log.info("mesh %s starts, attempt %d", claim.mesh_id, claim.attempt)
        function, arguments = self._run(claim, mesh_input)
        task = self._engine.submit(function, *arguments, time_limit=self._rules.time_limit)
        self._running[claim] = task
        task.add_done_callback(partial(self._end, claim))
        return task

    def _end(self, claim: Claim, task: Future[Any]) -> None:
        if _is_over(task):
            self._leave(claim)  # at once, in whatever thread this is: the worker has written its result already
            self._metrics.ended(task.result())
            if not self._queue_is_empty:
                self._wake.set()
        else:
            self._ended.put((claim, task))
            self._wake.set()
        self._notify(claim.mesh_id)

    def _leave(self, claim: Claim) -> None:
        """The worker that had a mesh has done with it."""
        with self._lock:
            self._running.pop(claim, None)
            self._call_up()

    def _settle(self) -> None:
        while not self._ended.empty():
            claim, task = self._ended.get()
            try:
                with log_context.enter(log_context_of(claim)):
                    self._conclude(claim, task.exception())
            except Exception:
                self._ended.put((claim, task))  # the store did not take it: once more, later
                raise
            self._leave(claim)
            self._notify(claim.mesh_id)

    def _conclude(self, claim: Claim, error: BaseException | None) -> None:
        rules = self._rules
        match error:
            case None:
                problem = Problem("internal-error", "The worker ended without a result.")
            case CancelledError():
                return
            case WorkerLostError():
                self._metrics.worker_lost()
                self._lost(claim, "the worker process died")
                return
            case TimeLimitError():
                problem = Problem("time-limit", f"The mesh was not finished within {rules.time_limit:g} s.")
            case MemoryLimitError():
                problem = Problem("memory-limit", f"The mesh needs more than {rules.memory_limit} MiB of memory.")
            case Problem(name="unavailable"):
                self._lost(claim, "files or database could not be reached")
                return
            case Problem():
                problem = error
            case _:
                _log.error("mesh %s: the worker failed", claim.mesh_id, exc_info=error)
                problem = Problem("internal-error", f"The worker failed: {type(error).__name__}.")
        # When all went well the mesh is finished already, and this changes nothing.
        if self._store.queue.finish(claim, error=problem.body()):
            self._metrics.ended(Ending(status=FAILED, reason=problem.name))
            _log.warning("mesh %s failed: %s", claim.mesh_id, problem.name)

    def _lost(self, claim: Claim, reason: str) -> None:
        most = self._rules.max_attempts
        problem = Problem("worker-lost", f"Given up after {most} attempts; at the last one {reason}.")
        status = self._store.queue.lose(claim, reason, most=most, error=problem.body())
        if status is not None:
            self._queue_is_empty = False
            self._metrics.lost(status)
            with log_context.enter(log_context_of(claim)):
                _log.warning("mesh %s, attempt %d: %s; now %s", claim.mesh_id, claim.attempt, reason, status)
            self._notify(claim.mesh_id)

    def _care(self) -> None:
        running = {claim for claim, _ in self._held()}
        strays = self._store.queue.renew(self._owner, self._rules.lease) - running
        for claim in strays & self._strays:  # twice in a row: not just on its way to a worker
            if self._store.queue.requeue(claim, "it had not reached a worker"):
                self._queue_is_empty = False
        self._strays = strays
        for claim in self._store.queue.abandoned():
            self._lost(claim, "its service fell silent")

    def _drop_gone(self) -> None:
        """Stop the work on what was canceled through another service, or taken over after a long silence."""
        running = dict(self._held())  # before the look: the store knows all of these
        gone = running.keys() - self._store.queue.held(self._owner)
        for claim in gone & self._gone:  # twice in a row: its worker has not just finished it
            self._engine.cancel(running[claim])
        self._gone = gone


def _is_over(task: Future[Any]) -> bool:
    """Whether a worker has brought its mesh to an end in the store."""
    return not task.cancelled() and task.exception() is None and isinstance(task.result(), Ending)
