"""The dispatcher: gives waiting meshes to the engine, and requeues those that lost their worker."""

import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from equimesh_service.dispatch.worker_line import WorkerLine
from equimesh_service.engine.port import Engine
from equimesh_service.errors import (
    EngineError,
    KeyReusedError,
    MemoryLimitError,
    SamplesGoneError,
    SchedulerLostError,
    StepTakenError,
    TimeLimitError,
    WorkerLostError,
)
from equimesh_service.problems.problem import Problem
from equimesh_service.problems.storage import storage_problem
from equimesh_service.store.rows import (
    FAILED,
    Claim,
    Ending,
    FinishedMesh,
    Lease,
    MeshInput,
    NoMesh,
    Outcome,
    keep_file,
)
from equimesh_service.store.store import Store
from equimesh_service.store.writer import Writer, store_finished
from equimesh_service.telemetry import log_context
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.worker.job import log_context_of

_log = logging.getLogger(__name__)
# The longest time between two rounds of a healthy thread; a wait for a locked database is half as long.
_MAX_ROUND_SECONDS = 60.0
# How often the dispatcher checks its claims; a task whose claim is gone is cancelled at the second check.
_CHECK_SECONDS = 0.4


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The settings of the dispatcher; times are in seconds, memory in MiB."""

    time_limit: float = 300.0
    memory_limit: int = 4096
    max_attempts: int = 3
    lease: float = 15.0
    poll: float = 0.2


class Dispatcher:
    """A thread that takes meshes from the queue of a store to the workers of an engine.

    It claims as many meshes as the engine has workers, renews the leases of its claims while they run, and takes back
    the claims of silent owners. The states of a claim::

        queued ── claim ──> running ── its result is written into the store ──> succeeded or failed
           ^                   ├── a limit is reached, or the worker raises ──> failed
           │                   ├── canceled, deleted or taken over ──> its task is cancelled
           ├───────────────────┤ its worker died or its owner is silent (failed after ``max_attempts``)
           └───────────────────┘ no worker has it, its scheduler is lost, or the service stops

    ``run`` gives the function and the arguments that a worker calls for a claim. A worker returns a
    :class:`FinishedMesh`, which a :class:`~equimesh_service.store.writer.Writer` stores. It stores a mesh with large
    files itself, and on a cluster every mesh that came from the queue. ``notify`` is called with the id of every mesh
    whose status may have changed, and ``discard`` with each file that no row names any more.

    A mesh whose request waits can skip the queue: reserve a worker in the :attr:`line`, put the mesh into the store as
    claimed by :attr:`lease`, and :meth:`begin` it, or release the worker. A request is begun before its mesh is in the
    store (:meth:`begin_request`): its worker enters the mesh as claimed by the lease, if it is not finished soon.
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
        discard: Callable[[str], None] = keep_file,
    ) -> None:
        self._owner = owner
        self._discard = discard
        self._store = store
        self._engine = engine
        self._run = run
        self._rules = rules
        self._notify = notify
        self._metrics = metrics or Metrics()
        self.lease = Lease(owner=owner, seconds=rules.lease)
        self._wake = threading.Event()
        self.line = WorkerLine(engine, lambda: (claim.key_id for claim in self._running), self._wake.set)
        self._writer = Writer(store.database)
        self._lock = self.line.lock  # guards the next three
        self._running: dict[Claim, Future[Any]] = {}
        self._storing: set[Claim] = set()  # claims that workers have finished, and that are not in the store yet
        self._woken = False  # since the current check of the queue began
        self._strays: set[Claim] = set()  # claims of this service that no worker has
        self._new: dict[str, str] = {}  # the meshes that workers have and the store may not, with their keys
        self._gone: set[Claim] = set()  # claims that workers have and this service has lost
        self._ended: queue.SimpleQueue[tuple[Claim, Future[Any]]] = queue.SimpleQueue()
        self._last_round = time.monotonic()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="equimesh-dispatcher", daemon=True)

    def start(self, *, alone: bool) -> None:
        """Start the thread. ``alone``: no other service uses the store, so no running mesh has a worker."""
        for claim in self._store.queue.find_abandoned(owner_gone=self._owner if alone else None):
            self._lost(claim, "the service stopped while a worker had this mesh")
        self._thread.start()

    def wake(self) -> None:
        """Check the queue now."""
        with self._lock:
            self.line.queue_is_empty, self._woken = False, True
        self._wake.set()

    def begin(self, claim: Claim, mesh_input: MeshInput) -> Future[Any]:
        """Give a claimed mesh to the reserved worker; the future ends when the mesh is in the store."""
        with self._lock:
            _, ended = self._submit(claim, *self._run(claim, mesh_input))
            self.line.use()
            return ended

    def begin_request(self, claim: Claim, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Let the reserved worker compute a mesh which is not in the store; the future is that of :meth:`begin`.

        ``function`` may also return :class:`NoMesh`, which the future then has.
        """
        with self._lock:
            self._new[claim.mesh_id] = claim.key_id
            try:
                _, ended = self._submit(claim, function, arguments)
            except BaseException:
                self._new.pop(claim.mesh_id, None)
                raise
            self.line.use()
            return ended

    def in_flight(self, key_id: str) -> tuple[str, ...]:
        """The meshes of a key that workers have, and that may not be in the store yet."""
        with self._lock:
            return tuple(mesh_id for mesh_id, owner in self._new.items() if owner == key_id)

    def cancel(self, mesh_id: str) -> None:
        """Stop the work on a mesh that was canceled or deleted in the store."""
        for claim, task in self._tasks():
            if claim.mesh_id == mesh_id:
                self._engine.cancel(task)
        self._notify(mesh_id)
        self._wake.set()

    def is_alive(self) -> bool:
        """Whether the thread runs, and began its last round less than a minute ago."""
        return self._thread.is_alive() and time.monotonic() - self._last_round < _MAX_ROUND_SECONDS

    def stop(self) -> None:
        """Stop the thread; running meshes go back into the queue."""
        self._stopping.set()
        self.line.close()
        self._wake.set()
        self._thread.join()
        self._writer.close()
        running = self._tasks()
        try:
            # Also the claims that have no worker yet.
            for claim in self._store.queue.renew(self._owner, self._rules.lease):
                if self._store.queue.requeue(claim, "the service was stopped"):
                    _log.info("mesh %s goes back into the queue", claim.mesh_id)
        except Exception as error:  # their leases expire, and other services take the meshes
            if storage_problem(error) is None:
                _log.exception("meshes could not be put back into the queue")
        for _, task in running:
            self._engine.cancel(task)

    def _loop(self) -> None:
        next_renewal = next_fill = next_check = time.monotonic()
        while not self._stopping.is_set():
            self._wake.clear()
            self._last_round = time.monotonic()
            try:
                self._settle()
                if time.monotonic() >= next_renewal:
                    self._renew_leases()
                    next_renewal = time.monotonic() + self._rules.lease / 3
                if self._running and time.monotonic() >= next_check:
                    self._cancel_gone()
                    next_check = time.monotonic() + _CHECK_SECONDS
                if not self.line.queue_is_empty or time.monotonic() >= next_fill:
                    self._fill()
                    next_fill = time.monotonic() + self._rules.poll  # other services may have added meshes
            except Exception as error:
                if storage_problem(error) is None:  # otherwise it is logged there
                    _log.exception("the dispatcher failed; it continues")
                self._stopping.wait(1.0)
            self._wake.wait(self._rules.poll)

    def _fill(self) -> None:
        missed = set[str]()  # keys whose meshes other services are claiming
        while self.line.reserve_for_first():
            self._woken = False
            try:
                found = self._store.queue.find_waiting()
            except BaseException:
                self.line.release()
                raise
            left = {key_id: share for key_id, share in found.shares.items() if key_id not in missed}
            # The flag changes only under the lock, so that no request overtakes the queue in between.
            with self._lock:
                self.line.queue_is_empty = not found.shares and not self._woken
                key_id = self.line.choose(replace(found, shares=left))
            if key_id is not None and not self._take(key_id):
                missed.add(key_id)
            elif not left:
                with self._lock:
                    self.line.call_next()
                return

    def _take(self, key_id: str) -> bool:
        """Give the oldest waiting mesh of a key to the reserved worker; False when another service has it."""
        try:
            claim = self._store.queue.claim(self._owner, self._rules.lease, key_id)
        except BaseException:
            self.line.release()
            raise
        with self._lock:
            self.line.use()
            if claim is None:
                return False
            task, _ = self._submit(claim, *self._run(claim, None))
            self.line.call_next()  # now that the claim has its worker
        row = self._store.meshes.get(claim.mesh_id)
        if row is None or row.finished:
            self._engine.cancel(task)  # canceled since the claim, when `cancel` did not see the task yet
        self._notify(claim.mesh_id)
        return True

    def _tasks(self) -> list[tuple[Claim, Future[Any]]]:
        with self._lock:
            return list(self._running.items())

    def _submit(
        self, claim: Claim, function: Callable[..., Any], arguments: tuple[Any, ...]
    ) -> tuple[Future[Any], Future[Any]]:
        """Give a claim to a worker; returns the future of the worker and the future of the mesh."""
        if claim.mesh_id not in self._new:
            self._metrics.count_attempt(claim.waited)
            with log_context.enter(log_context_of(claim)):
                _log.info("mesh %s starts, attempt %d", claim.mesh_id, claim.attempt)
        task = self._engine.submit(function, *arguments, time_limit=self._rules.time_limit)
        self._running[claim] = task
        ended = Future[Any]()
        task.add_done_callback(partial(self._end, claim, ended))
        return task, ended

    def _end(self, claim: Claim, ended: Future[Any], task: Future[Any]) -> None:
        finished = None if task.cancelled() or task.exception() is not None else task.result()
        with self._lock:
            if claim.mesh_id in self._new and not isinstance(finished, NoMesh):
                self._metrics.count_attempt(claim.waited)
        if isinstance(finished, FinishedMesh):
            with self._lock:
                self._storing.add(claim)
            self._free_worker(claim)  # which solves the next mesh meanwhile
            if not self.line.queue_is_empty:
                self._wake.set()
            self._write(claim, finished, ended)
            return
        if isinstance(finished, Ending | NoMesh):
            self._free_worker(claim)  # at once, in this thread: the worker has already written its result
            if isinstance(finished, Ending):
                self._metrics.count_end(finished)
            if not self.line.queue_is_empty:
                self._wake.set()
        else:
            self._ended.put((claim, task))
            self._wake.set()
        _pass_on(task, ended)
        self._notify(claim.mesh_id)

    def _write(self, claim: Claim, finished: FinishedMesh, ended: Future[Any]) -> None:
        """Put a finished mesh into the store, with others that wait for it."""
        try:
            stored = self._writer.commit(partial(store_finished, self._store, claim, finished, self._discard))
        except EngineError as error:  # the service stops, and the mesh is back in the queue
            ended.set_exception(error)
            return
        began = time.perf_counter()

        def note(stored: Future[str | None]) -> None:
            laps = {**finished.ending.laps, "commit": time.perf_counter() - began}
            self._note_stored(claim, replace(finished.ending, laps=laps), stored, ended)

        stored.add_done_callback(note)

    def _note_stored(self, claim: Claim, ending: Ending, stored: Future[str | None], ended: Future[Any]) -> None:
        error = stored.exception()
        if error is None:
            mesh_id = stored.result()
            if mesh_id == claim.mesh_id:
                self._metrics.count_end(ending)
            ended.set_result(ending if mesh_id == claim.mesh_id else mesh_id and NoMesh(earlier=mesh_id))
        elif isinstance(error, KeyReusedError | SamplesGoneError | StepTakenError):
            ended.set_result(NoMesh(error=error))
        else:
            ended.set_exception(storage_problem(error) or error)
            self._ended.put((claim, ended))
            self._wake.set()
            self._notify(claim.mesh_id)
            return
        with self._lock:
            self._storing.discard(claim)
        self._notify(claim.mesh_id)

    def _free_worker(self, claim: Claim) -> None:
        """Free the worker of a claim."""
        with self._lock:
            self._running.pop(claim, None)
            self._new.pop(claim.mesh_id, None)
            self.line.call_next()

    def _settle(self) -> None:
        while not self._ended.empty():
            claim, task = self._ended.get()
            try:
                with log_context.enter(log_context_of(claim)):
                    self._conclude(claim, task.exception())
            except Exception:
                self._ended.put((claim, task))  # the store failed: try again later
                raise
            with self._lock:
                self._storing.discard(claim)
            self._free_worker(claim)
            self._notify(claim.mesh_id)

    def _conclude(self, claim: Claim, error: BaseException | None) -> None:
        rules = self._rules
        match error:
            case None:
                problem = Problem("internal-error", "The worker ended without a result.")
            case CancelledError():
                return
            case WorkerLostError():
                self._metrics.count_lost_worker()
                self._lost(claim, "the worker process died")
                return
            case SchedulerLostError():
                self._return(claim, "the scheduler of the cluster was lost")
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
        # Usually the worker has finished the mesh, and this changes nothing.
        if self._store.queue.finish(claim, Outcome(error=problem.body())):
            self._metrics.count_end(Ending(status=FAILED, reason=problem.name))
            _log.warning("mesh %s failed: %s", claim.mesh_id, problem.name)

    def _lost(self, claim: Claim, reason: str) -> None:
        most = self._rules.max_attempts
        problem = Problem("worker-lost", f"Given up after {most} attempts; at the last one {reason}.")
        status = self._store.queue.lose(claim, reason, most=most, error=problem.body())
        if status is not None:
            self.line.queue_is_empty = False
            self._metrics.count_lost_attempt(status)
            with log_context.enter(log_context_of(claim)):
                _log.warning("mesh %s, attempt %d: %s; now %s", claim.mesh_id, claim.attempt, reason, status)
            self._notify(claim.mesh_id)

    def _return(self, claim: Claim, reason: str) -> None:
        """Put a mesh back into the queue, without counting a loss: no worker died over it."""
        if self._store.queue.requeue(claim, reason):
            self.line.queue_is_empty = False
            with log_context.enter(log_context_of(claim)):
                _log.warning("mesh %s, attempt %d: %s; now queued", claim.mesh_id, claim.attempt, reason)
            self._notify(claim.mesh_id)

    def _renew_leases(self) -> None:
        with self._lock:
            running = self._storing | self._running.keys()
        strays = self._store.queue.renew(self._owner, self._rules.lease) - running
        for claim in strays & self._strays:  # at two checks in a row, so it is not just on its way to a worker
            if self._store.queue.requeue(claim, "it had not reached a worker"):
                self.line.queue_is_empty = False
        self._strays = strays
        for claim in self._store.queue.find_abandoned():
            self._lost(claim, "its service stopped responding")

    def _cancel_gone(self) -> None:
        """Cancel the tasks of meshes that another service has canceled or taken over."""
        running = dict(self._tasks())  # before the store is read, which knows all of these but the new ones
        held = self._store.queue.find_held(self._owner)
        with self._lock:
            for claim in held:
                if self._new.pop(claim.mesh_id, None) is not None:
                    self._metrics.count_attempt(claim.waited)
            gone = {claim for claim in running.keys() - held if claim.mesh_id not in self._new}
        for claim in gone & self._gone:  # at two checks in a row, so its worker has not just finished it
            self._engine.cancel(running[claim])
        self._gone = gone


def _pass_on(task: Future[Any], ended: Future[Any]) -> None:
    """Let a future end as another one has."""
    if task.cancelled():
        ended.cancel()
    elif (error := task.exception()) is not None:
        ended.set_exception(error)
    else:
        ended.set_result(task.result())
