"""One running service: its parts, and the waits that involve several. :mod:`equimesh_service.opening` opens it."""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from io import TextIOWrapper
from typing import Any

from starlette.concurrency import run_in_threadpool

from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import Caller, Callers
from equimesh_service.admission.intake import Intake
from equimesh_service.admission.previews import Previews
from equimesh_service.admission.quotas import Quotas
from equimesh_service.dispatch.check_threads import Checked, CheckThreads
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.side_workers import SideWorkers
from equimesh_service.dispatch.wakeups import END, Wakeups
from equimesh_service.engine.port import Engine
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import Settings
from equimesh_service.store.rows import Artifact, MeshRow, SequenceRow
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.upkeep.readiness import Readiness
from equimesh_service.upkeep.retention import Retention
from equimesh_service.wire.body import BodyRoom
from equimesh_service.worker import export
from equimesh_service.worker.job import Export, Storage

_log = logging.getLogger(__name__)


@dataclass(kw_only=True)
class Service:
    """The parts of a service. ``engine`` solves; ``side_workers`` make files and pictures, and read samples."""

    settings: Settings
    storage: Storage
    store: Store
    files: Files
    engine: Engine
    side_workers: SideWorkers
    dispatcher: Dispatcher
    retention: Retention
    wakeups: Wakeups
    admission: Admission
    callers: Callers
    quotas: Quotas
    intake: Intake
    previews: Previews
    lock: TextIOWrapper | None
    check_threads: CheckThreads
    metrics: Metrics
    bodies: BodyRoom
    readiness: Readiness
    exporting: dict[Export, Future[Artifact | None]] = field(default_factory=dict)

    @property
    def is_ready(self) -> bool:
        """Whether all workers have started."""
        return self.engine.health().ready and self.side_workers.health().ready

    @property
    def fault(self) -> str:
        """Why workers do not start, "" while they may."""
        return self.engine.health().fault or self.side_workers.health().fault

    async def check(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """Run a check of a client's input, off the event loop.

        A check may take long (a million samples), so checks have a few threads of their own, and leave the others to
        other requests.
        """
        return await self.check_threads.run(function, *arguments)

    async def mesh(self, mesh_id: str, caller: Caller) -> MeshRow:
        """The mesh with this id; raises a 404 problem, also when the caller may not see it."""
        row = await run_in_threadpool(self.store.meshes.get, mesh_id)
        if row is None or not caller.sees(row.key_id):
            raise await self.missing_problem(mesh_id, caller, "There is no mesh with this id.")
        return row

    async def missing_problem(self, name: str, caller: Caller, detail: str) -> Problem:
        """The problem for an unknown id: 410 for an expired one of the caller, otherwise 404."""
        if await run_in_threadpool(self.store.retention.has_removed, name, caller.only):
            return Problem("gone", f"It was removed {self.settings.retention_days:g} days after its last use.")
        return Problem("not-found", detail)

    async def wait_for_end(self, mesh_id: str, seconds: float, caller: Caller) -> MeshRow:
        """Wait for the end of a mesh, at most ``seconds``; returns the mesh, raises a 404 problem."""
        deadline = time.monotonic() + min(seconds, self.settings.max_wait)
        while True:
            row = await self.mesh(mesh_id, caller)
            left = deadline - time.monotonic()
            if row.finished or left <= 0 or self.wakeups.closing:
                return row
            await self.wakeups.wait(mesh_id, left, seen=END)

    async def sequence(self, sequence_id: str, caller: Caller) -> SequenceRow:
        """The sequence with this id; raises a 404 problem, also when the caller may not see it."""
        row = await run_in_threadpool(self.store.sequences.get, sequence_id)
        if row is None or not caller.sees(row.key_id):
            raise await self.missing_problem(sequence_id, caller, "There is no sequence with this id.")
        return row

    async def artifact(self, mesh_id: str, name: str) -> Artifact:
        """A file of a finished mesh, written now if it does not exist yet."""
        found = await run_in_threadpool(self.store.meshes.artifact, mesh_id, name)
        if found is not None:
            return found
        here = log_context.current()
        task = Export(self.storage, mesh_id, name, here.request_id, tracing.traceparent())
        future = self.exporting.get(task)
        if future is None:
            future = self.side_workers.submit(here.key_id, export.export, task, time_limit=self.settings.time_limit)
            self.exporting[task] = future
            future.add_done_callback(lambda _: self.exporting.pop(task, None))
        try:
            artifact = await asyncio.wrap_future(future)
        except (TimeLimitError, MemoryLimitError) as error:
            raise Problem("unavailable", f"The file was not written: {error}.") from None
        except (EngineError, CancelledError) as error:
            raise Problem("unavailable", f"The file was not written: {error}.", headers={"Retry-After": "1"}) from None
        except FileNotFoundError:
            raise Problem("not-found", "The mesh was deleted while the file was written.") from None
        if artifact is None:
            raise Problem("not-found", "There is no mesh with this id.")
        return artifact

    def discard(self, sha256: str) -> None:
        """Remove a file that no row names any more; if that fails, the next sweep removes it."""
        try:
            self.files.remove(sha256)
        except OSError as error:
            _log.warning("file %s was not removed, the next sweep will try again: %s", sha256, type(error).__name__)

    def close(self) -> None:
        """Stop the work and close all parts; running meshes go back into the queue."""
        self.retention.stop()
        self.dispatcher.stop()
        self.engine.close()
        self.side_workers.close()
        self.store.close()
        if self.lock is not None:
            self.lock.close()
