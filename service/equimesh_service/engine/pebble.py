"""The embedded engine: a pool of worker processes on this machine, by Pebble."""

from __future__ import annotations

import atexit
import gc
import logging
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future, InvalidStateError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from equimesh_service.engine.port import Health
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError, WorkerLostError

# Workers hold the lock for less than a millisecond; for longer when they import a module for a task.
MAX_SILENT_SECONDS = 10.0
# The exit code of a process whose server died first: see :mod:`multiprocessing.popen_forkserver`.
SERVER_DIED_EXIT_CODE = 255


class PoolWatch:
    """The observations of one pool."""

    def __init__(self, pool: ProcessPool) -> None:
        self.pool = pool
        manager: Any = pool._pool_manager  # Pebble has no public access to it
        self._tasks, self._workers = manager.task_manager, manager.worker_manager
        self._free = time.monotonic()  # when the lock was last free
        self._alive: dict[int, BaseProcess] = {}
        self._died = 0.0  # when a worker last died
        self._forgotten: dict[int, float] = {}  # the times since when tasks are without a worker
        self._known: dict[int, Any] = {}
        self._last = 0  # the last task that was begun; they are begun in order

    def defect(self) -> str:
        """Why the pool must be replaced, "" when it need not be. Call it several times a second."""
        if not self.pool.active:
            return "it broke"
        now = time.monotonic()
        with self._workers.workers_channel.lock(block=False) as free:
            if free:
                self._free = now
        before, self._alive = self._alive, self._workers.workers.copy()
        codes = {before[pid].exitcode for pid in before.keys() - self._alive.keys()}
        if SERVER_DIED_EXIT_CODE in codes:
            return "the server that its workers are forked from died"
        # Workers that the pool stops do not count, since it takes the lock first.
        if codes - {-signal.SIGTERM}:
            self._died = now
        if now - self._free > MAX_SILENT_SECONDS and self._died >= self._free:
            return "a worker died while it took a task or gave a result"
        earlier, self._known = self._known, self._tasks.tasks.copy()
        tasks, ended = self._known.values(), (earlier[name] for name in earlier.keys() - self._known.keys())
        begun = [task for task in tasks if task.started]
        self._last = max([self._last, *(task.id for task in (*begun, *ended) if not task.future.cancelled())])
        lost = [task.id for task in begun if task.worker_id not in self._alive]
        lost += [task.id for task in tasks if not task.started and task.id < self._last and not task.future.cancelled()]
        self._forgotten = {name: self._forgotten.get(name, now) for name in lost}
        if any(now - since > MAX_SILENT_SECONDS for since in self._forgotten.values()):
            return "a worker died as it began a task"
        return ""


Result = TypeVar("Result")
_log = logging.getLogger(__name__)
_warmed_up = 0.0  # seconds, in a worker
# Seconds of a warm-up that is not worth a line in the log: of a worker that was forked warm.
_SHORT_WARM_UP = 0.05
# Pools that break before a worker has warmed up, until the start counts as failed. It is tried again all the same.
_MAX_BROKEN = 3
# Seconds before workers that could not warm up are replaced.
_PAUSE_SECONDS = 5.0
_fault: Exception | None = None  # what the warm-up of this worker raised
# Seconds for the threads of a pool to end; they need less than one.
_STOP_SECONDS = 30.0
# The time between two checks of the pool, and of a worker's parent.
_WATCH_SECONDS = 0.2
_server_lock = threading.Lock()
_THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class PebbleEngine:
    """A pool of ``workers`` processes; ``memory_limit`` is in MiB for each, on top of what it needs to start.

    ``preload`` names modules that are imported once, before the workers are forked. Each worker first calls
    ``prepare``, which sets up its log, then ``warm_up``. Workers that die and pools that break are replaced.
    """

    def __init__(
        self,
        workers: int,
        *,
        memory_limit: int | None = None,
        preload: Sequence[str] = (),
        warm_up: Callable[[], None] | None = None,
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._workers = workers
        self._context = _context(preload)
        # Workers hold the reading end, which closes when this process ends, however it ends.
        reader, self._lifeline = self._context.Pipe(duplex=False)
        self._start = (memory_limit, prepare, warm_up, reader)
        self._lock = threading.Lock()
        self._inner: dict[Future[Any], ProcessFuture[Any]] = {}
        # Tasks lost with a whole pool. Reported only when there is a new pool: an earlier retry would be lost again.
        self._lost: list[tuple[Future[Any], WorkerLostError]] = []
        self._closed = threading.Event()
        self._fault, self._broken = "", 0  # why workers do not start; pools that broke since one last did
        # The pool before this one. Its last workers may still be starting, and open its locks by their names, which are
        # removed with the locks.
        self._retired: ProcessPool | None = None
        self._pool, self._warm = self._new_pool()
        self._watcher = threading.Thread(target=self._watch, name="equimesh-pool-watch", daemon=True)
        self._watcher.start()

    def submit(
        self, function: Callable[..., Result], *arguments: Any, time_limit: float | None = None
    ) -> Future[Result]:
        """Run ``function(*arguments)`` in a worker; see :class:`~equimesh_service.engine.port.Engine`."""
        outer: Future[Result] = Future()
        outer.set_running_or_notify_cancel()
        with self._lock:
            if self._closed.is_set():
                raise EngineError("the engine is closed")
            try:
                inner = self._pool.schedule(_run, args=(function, arguments), timeout=time_limit)
            except RuntimeError as error:  # the pool broke, and is about to be replaced
                self._lost.append((outer, WorkerLostError(f"there are no workers: {error}")))
                return outer
            self._inner[outer] = inner
        inner.add_done_callback(lambda done: self._hand_over(done, outer))
        return outer

    def cancel(self, task: Future[Any]) -> None:
        """Give up the task; a worker that runs it is killed and replaced."""
        with self._lock:
            inner = self._inner.get(task)
        if inner is not None:
            inner.cancel()  # type: ignore[no-untyped-call]

    def health(self) -> Health:
        """Ready once a worker has warmed up."""
        with self._lock:
            active = bool(self._pool.active) and not self._lost and not self._closed.is_set()
            warm = self._warm.done() and not self._warm.cancelled() and self._warm.exception() is None
        ready = active and warm
        fault = "" if ready else self._fault
        detail = fault or ("workers are starting" if active else "the worker pool is down")
        return Health(ready=ready, workers=self._workers, detail="" if ready else detail, fault=fault)

    def wait_until_ready(self, timeout: float) -> bool:
        """Block until a worker has warmed up; False when that takes longer than ``timeout`` seconds."""
        end = time.monotonic() + timeout
        while not self.health().ready:
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

    def close(self) -> None:
        """Stop all workers at once."""
        with self._lock:
            self._closed.set()
            left = list(self._inner.values())
        self._watcher.join()  # no new pool from now on
        for inner in left:
            inner.cancel()  # type: ignore[no-untyped-call]
        _stop(self._pool)
        self._report_lost()

    def _watch(self) -> None:
        seen = PoolWatch(self._pool)
        while not self._closed.wait(_WATCH_SECONDS):
            try:
                defect = seen.defect() or ("its workers are gone" if self._lost else "")
                defect = self._failed_start(defect) or defect
                if defect:
                    _log.warning("the worker pool is replaced: %s", defect)
                    self._replace(defect)
                    seen = PoolWatch(self._pool)
            except Exception:  # for instance when no process can be started
                _log.exception("the worker pool is down; it will be replaced")
                self._report_lost()  # there may never be a new pool

    def _failed_start(self, defect: str) -> str:
        """Why the pool must be replaced since its workers cannot warm up, "" while they may; counts its defects."""
        ended = self._warm.done() and not self._warm.cancelled()
        error = self._warm.exception() if ended else None
        if ended and error is None:
            self._fault, self._broken = "", 0
            return ""
        self._broken += bool(defect)
        if error is not None and not isinstance(error, ProcessExpired | BrokenProcessPool):
            self._fault = f"the workers cannot warm up: {type(error).__name__}: {error}"
            _log.error("the workers cannot warm up", exc_info=error)
        elif defect and self._broken >= _MAX_BROKEN:
            self._fault = "the workers die when they start; perhaps the system lacks memory"
        else:
            return ""
        # Unless the engine is closed meanwhile.
        return "" if self._closed.wait(_PAUSE_SECONDS) else "its workers cannot start"

    def _replace(self, defect: str) -> None:
        fresh, warm = self._new_pool()
        with self._lock:
            broken, self._pool, self._warm = self._pool, fresh, warm
            self._retired = broken
            lost = list(self._inner.values())
        _stop(broken)  # without the lock, which its threads may need to hand over results
        for inner in lost:
            try:
                inner.set_exception(BrokenProcessPool(defect))
            except InvalidStateError:
                continue  # it ended by itself
        self._report_lost()

    def _report_lost(self) -> None:
        with self._lock:
            lost_tasks, self._lost = self._lost, []
        for outer, error in lost_tasks:
            outer.set_exception(error)

    def _new_pool(self) -> tuple[ProcessPool, ProcessFuture[float]]:
        pool = ProcessPool(
            max_workers=self._workers, initializer=_initialize, initargs=self._start, context=self._context
        )
        warm: ProcessFuture[float] = pool.schedule(_warm_up_seconds)
        warm.add_done_callback(_log_warm_up)
        return pool, warm

    def _hand_over(self, inner: Future[Any], outer: Future[Any]) -> None:
        with self._lock:
            self._inner.pop(outer, None)
        if inner.cancelled():
            outer.set_exception(CancelledError())
            return
        error = inner.exception()
        match error:
            case None:
                outer.set_result(inner.result())
            case TimeoutError() if not hasattr(error, "traceback"):  # Pebble's own, not the function's
                outer.set_exception(TimeLimitError("the time limit was reached"))
            case ProcessExpired(exitcode=code) if code != SERVER_DIED_EXIT_CODE:
                outer.set_exception(WorkerLostError(f"the worker died: {error}"))
            case ProcessExpired() | BrokenProcessPool():
                with self._lock:
                    self._lost.append((outer, WorkerLostError(f"the worker died: {error}")))
            case _:
                outer.set_exception(error)


def _context(preload: Sequence[str]) -> Any:
    if sys.platform == "win32":  # pragma: no cover
        return multiprocessing.get_context("spawn")
    context = _Forking()
    context.set_forkserver_preload(list(preload))
    _start_server()
    return context


if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess

    class _Worker(ForkServerProcess):
        """A process that is forked from the server, which is restarted when it is gone."""

        def start(self) -> None:
            _start_server()
            with _main_hidden():
                super().start()

    class _Forking(ForkServerContext):
        Process = _Worker


def _start_server() -> None:
    """Start the process that workers are forked from, unless it runs."""
    # One thread in each worker, as there are as many workers as processors. Libraries read this when the server loads
    # them.
    with _server_lock:
        atexit.unregister(_end_server)
        atexit.register(_end_server)
        missing = [name for name in _THREAD_COUNTS if name not in os.environ]
        try:
            for name in missing:
                os.environ[name] = "1"
            forkserver.ensure_running()
        finally:
            for name in missing:
                del os.environ[name]


@contextmanager
def _main_hidden() -> Iterator[None]:
    """Keep a new process from importing the main module, which it does not need.

    A script that calls :func:`~equimesh_service.running` outside of ``if __name__ == "__main__"`` would otherwise start
    a service in every worker of its service.
    """
    main = vars(sys.modules["__main__"])
    with _server_lock:
        hidden: dict[str, Any] = {name: main[name] for name in ("__spec__", "__file__") if name in main}
        main.update(dict.fromkeys(hidden))
        try:
            yield
        finally:
            main.update(hidden)


def _end_server() -> None:
    """End the process that workers are forked from: by itself it would first load all that it was told to load."""
    with _server_lock:
        server: Any = forkserver._forkserver
        if server._forkserver_pid is not None:
            with suppress(ProcessLookupError):
                os.kill(server._forkserver_pid, signal.SIGKILL)
            server._stop()


def _log_warm_up(done: Future[float]) -> None:
    if not done.cancelled() and done.exception() is None and done.result() > _SHORT_WARM_UP:
        _log.info("a worker warmed up in %.1f s", done.result())


def _stop(pool: ProcessPool) -> None:
    """Stop the workers of a pool at once, and wait for its threads, but not for ever.

    A thread of the pool may be reading a result when the pool closes the pipe. It then waits for the rest, which
    never comes.
    """
    pool.stop()  # type: ignore[no-untyped-call]
    joining = threading.Thread(target=pool.join, name="equimesh-pool-stop", daemon=True)
    joining.start()
    joining.join(_STOP_SECONDS)
    if joining.is_alive():
        _log.warning("the threads of a worker pool did not end; its workers are killed")
        for worker in [*pool._pool_manager.worker_manager.workers.values()]:
            worker.kill()


def _run(function: Callable[..., Result], arguments: tuple[Any, ...]) -> Result:
    try:
        return function(*arguments)
    except MemoryError:
        pass
    gc.collect()  # nothing refers to the objects of the task now, and the next one needs the memory
    raise MemoryLimitError("the memory limit was reached")


def _warm_up_seconds() -> float:
    """The duration of the warm-up of this worker; raises what the warm-up raised."""
    if _fault is not None:
        raise _fault
    return _warmed_up


def _initialize(
    memory_limit: int | None,
    prepare: Callable[[], None] | None,
    warm_up: Callable[[], None] | None,
    lifeline: Connection[Any, Any],
) -> None:
    # Pebble stops a worker by SIGTERM. Python would handle it between two instructions, after a long factorisation.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_die_with_parent, args=(lifeline, os.getppid()), daemon=True).start()
    if prepare is not None:
        prepare()
    if warm_up is not None:
        global _warmed_up, _fault
        began = time.perf_counter()
        try:
            warm_up()
        except Exception as error:  # the service learns of it, and replaces this worker
            _fault = error
        _warmed_up = time.perf_counter() - began
    if memory_limit is not None:
        _limit_memory(memory_limit)


def _die_with_parent(lifeline: Connection[Any, Any], parent: int) -> None:
    # The service may be killed before it stops its workers, and an orphan would compute in vain. So would a worker
    # without the server that it was forked from: the service knows of it through the server alone.
    while not lifeline.poll(_WATCH_SECONDS):
        if os.getppid() != parent:
            break
    os._exit(1)


def _limit_memory(mebibytes: int) -> None:
    if sys.platform != "linux":  # pragma: no cover - elsewhere the system does not enforce this limit
        return
    import resource

    with open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = held + mebibytes * 1024 * 1024
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
