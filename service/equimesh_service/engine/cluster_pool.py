"""The pool of processes that a Dask worker owns, its settings, and the requests of a service to it.

A task in a thread of a Dask worker can neither be killed nor be limited in its memory. So the worker runs none of the
jobs itself: its task gives the job to a process of the pool and waits. When the scheduler gives up the task, for
instance because its client is gone, the process is killed.
"""

from __future__ import annotations

import asyncio
import logging
import multiprocessing
import platform
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker
from distributed.worker_state_machine import SecedeEvent

from equimesh_service.engine.port import PackedCall, PoolSettings, pack_error, pack_outcome
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.errors import EngineError, WorkerLostError

_PACKAGES = ("equimesh", "distributed", "cloudpickle", "numpy")
# Of these, releases with the same first two numbers read each other's pickles.
_BY_TWO_NUMBERS = ("Python", "numpy")
_MISSING = "none"


def versions() -> dict[str, str]:
    """The versions in this process, by name."""
    return {"Python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}}


def describe_difference(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """In what a worker ``there`` differs from ``here``, as words; "" where it does not."""
    different = [name for name in here if _relevant(name, here) != _relevant(name, there)]
    return ", ".join(f"{name} {there.get(name, _MISSING)} in place of {here[name]}" for name in different)


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return _MISSING


def _relevant(name: str, found: Mapping[str, str]) -> str:
    text = found.get(name, _MISSING)
    return ".".join(text.split(".")[:2]) if name in _BY_TWO_NUMBERS else text


@dataclass(frozen=True, kw_only=True)
class PoolReport:
    """The state of a pool: the number of jobs that it takes at the same time, and whether it takes any now.

    ``identity`` names the process of the worker. ``fault`` is the reason why it cannot be used, "" while it starts.
    """

    identity: str
    slots: int
    versions: Mapping[str, str]
    ready: bool
    fault: str = ""

    def packed(self) -> dict[str, Any]:
        """The report as a record of plain values."""
        return asdict(self)

    @classmethod
    def of(cls, packed: Mapping[str, Any]) -> PoolReport:
        """The report in a record; unknown values, of other releases, are left out."""
        known = {name: packed[name] for name in cls.__dataclass_fields__ if name in packed}
        return cls(**known)


_log = logging.getLogger(__name__)
# A pool that no service has visited for this time is closed.
MAX_SILENT_SECONDS = 90.0
# The time between two looks of a pool at itself.
_WATCH_SECONDS = 0.2
# The longest time that it takes to replace the processes of a pool.
_REPLACEMENT_SECONDS = 5.0
# The time between two checks of what a worker reaches: after a success, and after a fault.
_CHECK_SECONDS = 30.0
_CHECK_AGAIN_SECONDS = 3.0
# A check that takes longer has failed.
_MAX_CHECK_SECONDS = 30.0
# States of a task on a worker from which its result is not needed any more.
_GIVEN_UP = ("cancelled", "released", "forgotten")


@dataclass(eq=False)
class ClusterPool(WorkerPlugin):
    """The plugin that owns the pool of one worker; one process for each of the worker's threads."""

    settings: PoolSettings
    _engine: ProcessEngine | None = None
    _worker: Worker | None = None
    _running: dict[str, Future[bytes]] = field(default_factory=dict)  # the jobs by the keys of their tasks
    _waiting: set[str] = field(default_factory=set)  # the keys of jobs for which there are no processes now
    _begun: set[str] = field(default_factory=set)
    _well: float = float("-inf")  # when the processes were last seen at work
    _fault: str | None = None  # what the worker cannot reach; None before the first check
    _visited: float = 0.0
    _watching: asyncio.Task[None] | None = None

    async def setup(self, worker: Worker) -> None:
        """Open the pool; without waiting until its processes are ready."""
        self._worker, self._visited = worker, time.monotonic()
        worker.metrics[self.settings.name] = self.report
        self._watching = asyncio.create_task(self._watch())

    async def teardown(self, worker: Worker) -> None:
        """Close the pool; what runs in it is killed."""
        worker.metrics.pop(self.settings.name, None)
        if self._watching is not None:
            self._watching.cancel()
            with suppress(asyncio.CancelledError):
                await self._watching
        if self._engine is not None:
            await asyncio.to_thread(self._engine.close)

    def transition(self, key: Any, start: str, finish: str, **more: Any) -> None:  # noqa: ARG002
        """Kill a job whose task is given up; Dask calls this for every change of a task."""
        if finish not in _GIVEN_UP:
            return
        self._waiting.discard(key)
        if key in self._running and self._engine is not None:
            self._engine.cancel(self._running[key])

    def report(self, worker: Worker) -> dict[str, Any]:
        """The state of the pool; the worker sends it to the scheduler with each sign of life, as one of its metrics."""
        # While the processes are replaced, which takes a moment, jobs wait for them here.
        ready = time.monotonic() - self._well < _REPLACEMENT_SECONDS and self._fault == ""
        return PoolReport(
            identity=worker.id, slots=worker.state.nthreads, versions=versions(), ready=ready, fault=self._fault or ""
        ).packed()

    def note_visit(self) -> None:
        """Stay open for a while: a service needs this pool."""
        self._visited = time.monotonic()

    async def run(self, key: str, call: PackedCall, time_limit: float | None) -> bytes:
        """The outcome of a job in a process of the pool."""
        if self._engine is None or key in self._begun:
            return pack_error(WorkerLostError("the pool is closed, or has begun this job before"))
        self._begun.add(key)
        if not await self._wait_until_ready(self._engine, key):
            return pack_error(CancelledError())
        try:
            job = self._engine.submit(pack_outcome, call, time_limit=time_limit)
        except EngineError as error:
            return pack_error(WorkerLostError(str(error)))
        self._running[key] = job
        try:
            return await asyncio.wrap_future(job)
        except EngineError as error:
            return pack_error(error)
        except asyncio.CancelledError:
            if not job.done():  # the task itself was cancelled, with its worker
                self._engine.cancel(job)
                raise
            return pack_error(CancelledError())
        finally:
            self._running.pop(key, None)

    async def _wait_until_ready(self, engine: ProcessEngine, key: str) -> bool:
        """Wait until the processes are there; False when the job is given up meanwhile."""
        self._waiting.add(key)
        while key in self._waiting and not engine.health().ready:
            await asyncio.sleep(_WATCH_SECONDS / 4)
        there = key in self._waiting
        self._waiting.discard(key)
        return there

    async def _watch(self) -> None:
        assert self._worker is not None
        self._engine = await asyncio.to_thread(self._open, self._worker.state.nthreads)
        checking: asyncio.Task[None] | None = None
        while time.monotonic() - self._visited < MAX_SILENT_SECONDS or self._running:
            if self._engine.health().ready:
                self._well = time.monotonic()
                if checking is None or checking.done():
                    checking = asyncio.create_task(self._check(self._engine))
            await asyncio.sleep(_WATCH_SECONDS)
        _log.info("no service has asked for %s for %.0f s; it is closed", self.settings.name, MAX_SILENT_SECONDS)
        self._watching = None
        await self._worker.plugin_remove(name=self.settings.name)

    def _open(self, slots: int) -> ProcessEngine:
        # The worker of a nanny is a daemonic process, which may have no children, since they would outlive it. Those of
        # the pool end with it however it ends.
        multiprocessing.current_process().daemon = False
        settings = self.settings
        return ProcessEngine(
            slots,
            memory_limit=settings.memory_limit,
            preload=settings.preload,
            warm_up=settings.warm_up,
            prepare=settings.prepare,
        )

    async def _check(self, engine: ProcessEngine) -> None:
        """Check what the worker reaches, and wait until it is to be checked again."""
        self._fault = await self._find_fault(engine)
        await asyncio.sleep(_CHECK_AGAIN_SECONDS if self._fault else _CHECK_SECONDS)

    async def _find_fault(self, engine: ProcessEngine) -> str:
        if self.settings.check is None:
            return ""
        try:
            return str(await asyncio.wrap_future(engine.submit(self.settings.check, time_limit=_MAX_CHECK_SECONDS)))
        except WorkerLostError:  # it was not the check
            return self._fault or ""
        except Exception as error:
            return f"the check of what it reaches failed ({type(error).__name__}: {error})"


async def visit(settings: PoolSettings, dask_worker: Worker) -> None:
    """Open the pool of a worker, or keep it open; called on the worker by ``Client.run``."""
    pool = dask_worker.plugins.get(settings.name)
    if isinstance(pool, ClusterPool):
        pool.note_visit()
    else:
        await dask_worker.plugin_add(plugin=ClusterPool(settings), name=settings.name)


async def run_in_pool(name: str, identity: str, key: str, call: PackedCall, time_limit: float | None) -> bytes:
    """The outcome of a job in the pool of the worker that runs this task.

    Dask runs the tasks of a lost worker again. The job is not run again: only in the process with this ``identity``.
    """
    worker = get_worker()
    pool = worker.plugins.get(name)
    if worker.id != identity or not isinstance(pool, ClusterPool):
        return pack_error(WorkerLostError("the worker for this job is gone"))
    # The processes of the pool are what limits the jobs. A thread of the worker stays free for the parts of meshes that
    # a job may request from the cluster.
    worker.handle_stimulus(SecedeEvent(key=key, compute_duration=0.0, stimulus_id=f"secede-{key}"))
    return await pool.run(key, call, time_limit)
