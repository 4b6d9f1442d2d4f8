"""One running service: its parts, and the waits that cross them. :mod:`equimesh_service.opening` opens it."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from io import TextIOWrapper
from typing import Any

from starlette.concurrency import run_in_threadpool

from equimesh_service.admission.admit import Admission, Admitted
from equimesh_service.admission.callers import Caller, Callers
from equimesh_service.admission.quotas import Quotas, quota_problem
from equimesh_service.dispatch.check_threads import Checked, CheckThreads
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.side_workers import SideWorkers
from equimesh_service.dispatch.wakeups import END, Wakeups
from equimesh_service.engine.port import Engine
from equimesh_service.errors import (
    EngineError,
    KeyReusedError,
    MemoryLimitError,
    QuotaError,
    SamplesGoneError,
    StepTakenError,
    TimeLimitError,
)
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import Settings
from equimesh_service.store.rows import (
    Artifact,
    Claim,
    Ending,
    Lease,
    MeshInput,
    MeshRow,
    NewMesh,
    NewStep,
    SequenceRow,
)
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.upkeep.readiness import Readiness
from equimesh_service.upkeep.retention import Retention
from equimesh_service.worker import export
from equimesh_service.worker.job import Export, Storage

_log = logging.getLogger(__name__)
# Longest wait of a request in the line for a worker. After it the mesh waits in the store, where nothing is lost.
_MAX_LINE_SECONDS = 1.0


@dataclass(frozen=True)
class Asked:
    """A mesh that is in the store, and the work on it where that has begun already."""

    mesh_id: str
    task: Future[Any] | None = None


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
    lock: TextIOWrapper | None
    check_threads: CheckThreads
    metrics: Metrics
    readiness: Readiness
    exporting: dict[Export, Future[Artifact | None]] = field(default_factory=dict)

    @property
    def is_ready(self) -> bool:
        """Whether all workers have started."""
        return self.engine.health().ready and self.side_workers.health().ready

    async def check(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """Run a check of what a client sent, off the event loop.

        Checks may take long (a million samples), so they have a few threads of their own: however many there
        are, the other requests are served.
        """
        return await self.check_threads.run(function, *arguments)

    async def mesh(self, mesh_id: str, caller: Caller) -> MeshRow:
        """The mesh with this id; raises a 404 problem, also when the caller may not see it."""
        row = await run_in_threadpool(self.store.meshes.get, mesh_id)
        if row is None or not caller.sees(row.key_id):
            raise await self.missing(mesh_id, caller, "There is no mesh with this id.")
        return row

    async def missing(self, name: str, caller: Caller, detail: str) -> Problem:
        """The problem for an unknown id: 410 where the caller's mesh or samples have expired."""
        if await run_in_threadpool(self.store.retention.was_there, name, caller.only):
            return Problem("gone", f"It was removed {self.settings.retention_days:g} days after its last use.")
        return Problem("not-found", detail)

    async def finished(self, mesh_id: str, seconds: float, caller: Caller) -> MeshRow:
        """The mesh, once it is finished or after ``seconds``; raises a 404 problem."""
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
            raise await self.missing(sequence_id, caller, "There is no sequence with this id.")
        return row

    async def ask(
        self,
        admitted: Admitted,
        caller: Caller,
        *,
        key: str | None,
        format: str | None,
        seconds: float,
        reuse: bool,
        step: NewStep | None = None,
    ) -> Asked:
        """Put an admitted spec into the queue or, when the request waits ``seconds``, give it to a worker at once.

        With ``reuse`` a finished mesh of the same spec answers the request, if there is one. The mesh may be the
        ``step`` of a sequence. Raises 409, 422 and 429 problems.
        """
        new = _new_mesh(admitted, caller, format)
        if step is not None:
            new = replace(new, fingerprint=None)  # its points depend on the steps before, and it has its own fields
        if reuse and self.settings.reuse:
            with refusals():
                again = await run_in_threadpool(
                    self.store.meshes.reuse, new, key=key, fingerprint=admitted.fingerprint(format)
                )
            if again is not None:
                log_context.current().mesh_id = again
                return Asked(again)
        fingerprint = admitted.fingerprint(format) if step is None else step.fingerprint
        reserved = seconds > 0 and self.dispatcher.line.reserve()
        if not reserved:
            known = await self._find_repeated(new, key, fingerprint)
            if known is not None:  # a repeated request adds no work
                log_context.current().mesh_id = known
                return Asked(known)
            reserved = seconds > 0 and await self._stand_in_line(min(seconds, _MAX_LINE_SECONDS))
        lease = self.dispatcher.lease if reserved else None
        try:
            asked = await self._add(admitted, caller, new, key, fingerprint, lease, step)
        except BaseException:
            if lease is not None:
                self.dispatcher.line.release()
            raise
        log_context.current().mesh_id = asked.mesh_id
        return asked

    async def _find_repeated(self, new: NewMesh, key: str | None, fingerprint: str) -> str | None:
        """The mesh of an earlier request with this idempotency key."""
        if key is None:
            return None
        with refusals():
            return await run_in_threadpool(self.store.meshes.find_repeated, new.key_id, key, fingerprint)

    async def _stand_in_line(self, seconds: float) -> bool:
        """Wait for a worker to be reserved; False where none came free in time."""
        turn, reserved = self.dispatcher.line.join(), False
        try:
            async with asyncio.timeout(seconds):
                reserved = await asyncio.shield(asyncio.wrap_future(turn))
        except TimeoutError:
            pass
        finally:
            if not reserved:
                self.dispatcher.line.leave(turn)
        return reserved

    async def _add(
        self,
        admitted: Admitted,
        caller: Caller,
        new: NewMesh,
        key: str | None,
        fingerprint: str,
        lease: Lease | None,
        step: NewStep | None,
    ) -> Asked:
        if lease is None and await run_in_threadpool(self.store.queue.waiting) >= self.settings.max_queue:
            raise Problem("queue-full", "Too many meshes are waiting.", headers={"Retry-After": "10"})
        with tracing.span("enqueue"), refusals():
            mesh_id = await run_in_threadpool(
                self.store.meshes.add,
                new,
                key=key,
                fingerprint=fingerprint,
                quota=self.quotas.for_mesh(caller),
                lease=lease,
                step=step,
            )
        if lease is None:
            self.dispatcher.wake()
            return Asked(mesh_id)
        if mesh_id != new.id:  # an older one of the same key
            self.dispatcher.line.release()
            return Asked(mesh_id)
        mesh_input = MeshInput(spec=admitted.spec, samples=admitted.samples, format=new.format)
        if step is not None:
            fields = None if step.fields is None else step.fields.sha256
            mesh_input = replace(mesh_input, start=step.start, fields=fields)
        claim = Claim(mesh_id, 1, time.time(), 0.0, new.request_id, new.key_id, new.trace)
        try:
            return Asked(mesh_id, self.dispatcher.begin(claim, mesh_input))
        except EngineError:
            self.dispatcher.line.release()  # the mesh is there, and the dispatcher sees that no worker has it
            return Asked(mesh_id)

    async def ending(self, asked: Asked, seconds: float) -> Ending | None:
        """How a mesh ended that a worker got at once; None for others, and for one that runs after ``seconds``."""
        if asked.task is None:
            return None
        # Not by `asyncio.wrap_future`, which logs an exception that comes when nobody waits any more.
        task, deadline = asked.task, time.monotonic() + min(seconds, self.settings.max_wait)
        while not task.done() and (left := deadline - time.monotonic()) > 0 and not self.wakeups.closing:
            await self.wakeups.wait(asked.mesh_id, min(left, self.settings.poll))
        if not task.done() or task.cancelled() or task.exception() is not None:
            return None  # the store has the answer, now or soon
        return task.result() if isinstance(task.result(), Ending) else None

    async def artifact(self, mesh_id: str, name: str) -> Artifact:
        """A file of a finished mesh, made now if it is not there yet."""
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
            made = await asyncio.wrap_future(future)
        except (TimeLimitError, MemoryLimitError) as error:
            raise Problem("unavailable", f"The file was not made: {error}.") from None
        except (EngineError, CancelledError) as error:
            raise Problem("unavailable", f"The file was not made: {error}.", headers={"Retry-After": "1"}) from None
        except FileNotFoundError:
            raise Problem("not-found", "The mesh was deleted while the file was made.") from None
        if made is None:
            raise Problem("not-found", "There is no mesh with this id.")
        return made

    def discard(self, sha256: str) -> None:
        """Remove a file that no row names any more; what cannot be removed now is left for the sweep."""
        try:
            self.files.remove(sha256)
        except OSError as error:
            _log.warning("file %s is left for the sweep: %s", sha256, type(error).__name__)

    def close(self) -> None:
        """Stop the work and close all parts; running meshes go back into the queue."""
        self.retention.stop()
        self.dispatcher.stop()
        self.engine.close()
        self.side_workers.close()
        self.store.close()
        if self.lock is not None:
            self.lock.close()


def _new_mesh(admitted: Admitted, caller: Caller, format: str | None) -> NewMesh:
    return NewMesh(
        id=f"m-{secrets.token_hex(10)}",
        spec=admitted.spec,
        samples=tuple(admitted.samples),
        format=format,
        key_id=caller.key_id,
        request_id=log_context.current().request_id or None,
        trace=tracing.traceparent(),
        fingerprint=admitted.points_fingerprint,
    )


@contextmanager
def refusals() -> Iterator[None]:
    """Raise what keeps a mesh out of the store as problems."""
    try:
        yield
    except KeyReusedError:
        raise Problem("idempotency-key-reused", "The key was used for another spec.") from None
    except QuotaError as error:
        raise quota_problem(error) from None
    except StepTakenError:
        detail = "The sequence has taken another step meanwhile, or lost the one that this follows: look at it again."
        raise Problem("conflict", detail) from None
    except SamplesGoneError:
        raise Problem("conflict", "The samples were deleted at this moment; upload them again.") from None
