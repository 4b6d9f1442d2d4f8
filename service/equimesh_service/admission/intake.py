"""The way of an admitted mesh: it enters the queue, goes straight to a worker, or reuses an earlier mesh."""

from __future__ import annotations

import pickle
import secrets
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from starlette.concurrency import run_in_threadpool

from equimesh_service.admission.callers import Caller, Quotas, quota_problem
from equimesh_service.admission.formats import check_format
from equimesh_service.admission.tasks import ANSWER, AdmittedSpec, PackedProblems, Request, StepPlace
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.errors import EngineError, KeyReusedError, QuotaError, SamplesGoneError, StepTakenError
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import Settings
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Claim, Ending, Lease, MeshInput, NewEntry, NewMesh, NewStep, NoMesh
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, stopwatch, tracing
from equimesh_service.upkeep.metrics import Metrics
from equimesh_service.worker.job import Storage

# The longest wait of a request in the line for a worker. After it the mesh enters the queue, which survives a crash.
MAX_LINE_SECONDS = 1.0
# The time that a worker has for this after the wait of the request. It may be stuck, or check the request for long,
# which a side worker then does.
_MAX_ENTRY_SECONDS = 1.0


@dataclass(frozen=True, kw_only=True)
class MeshRequest:
    """A request for a mesh, without its spec.

    ``format`` is the format of the requested file, ``seconds`` the wait of the request, ``key`` its idempotency key.
    With ``reuse`` a finished mesh of the same spec may answer it. ``step`` makes the mesh a step of a sequence.
    """

    format: str | None
    seconds: float
    key: str | None = None
    reuse: bool = False
    step: NewStep | None = None


@dataclass(frozen=True)
class AcceptedMesh:
    """A mesh that is in the store, and the task of its worker where it went straight to one.

    ``waited`` are the seconds that its request has waited for it.
    """

    mesh_id: str
    task: Future[Any] | None = None
    waited: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Body:
    """A request for a mesh as it came."""

    content_type: str
    content: bytes
    caller: Caller


@dataclass(frozen=True)
class Intake:
    """Gives requests to workers, or puts their meshes into the queue."""

    settings: Settings
    storage: Storage
    store: Store
    dispatcher: Dispatcher
    wakeups: Wakeups
    quotas: Quotas
    problems: PackedProblems
    metrics: Metrics
    admit: Callable[[Body], Awaitable[AdmittedSpec]]

    async def take(self, body: Body, request: MeshRequest) -> AcceptedMesh:
        """Let a worker admit and compute the mesh of a request that waits; otherwise admit it into the queue.

        Raises the problems of a request that is refused. The mesh is in the store when this returns.
        """
        longest = min(request.seconds, MAX_LINE_SECONDS)
        if request.seconds > 0 and await self.dispatcher.line.obtain(body.caller.key_id, body.caller.share, longest):
            stopwatch.lap("line")
            accepted = await self._compute(body, request)
            if accepted is not None:
                log_context.current().mesh_id = accepted.mesh_id
                return accepted
        admitted = await self.admit(body)
        stopwatch.lap("check")
        return await self._accept_admitted(admitted, body.caller, request)

    async def take_step(self, body: Body, request: MeshRequest, place: StepPlace) -> AcceptedMesh | None:
        """Let a worker check and compute a step of a request that waits; None where the service has to check it.

        Raises the problems of a step that is refused.
        """
        longest, caller = min(request.seconds, MAX_LINE_SECONDS), body.caller
        if not request.seconds > 0 or not await self.dispatcher.line.obtain(caller.key_id, caller.share, longest):
            return None
        stopwatch.lap("line")
        accepted = await self._compute(body, request, place)
        if accepted is not None:
            log_context.current().mesh_id = accepted.mesh_id
        return accepted

    async def _accept_admitted(self, admitted: AdmittedSpec, caller: Caller, request: MeshRequest) -> AcceptedMesh:
        self.metrics.count_uploads(admitted.uploads)
        if admitted.is_in_parts:
            await self.quotas.check_bytes(caller, admitted.expected_bytes)
        return await self.accept(admitted, caller, request)

    async def _compute(self, body: Body, request: MeshRequest, place: StepPlace | None = None) -> AcceptedMesh | None:
        """Give a request to the reserved worker; None when no worker has it, and the store does not know it."""
        caller = body.caller
        claim = _new_claim(caller)
        task = Request(
            content_type=body.content_type,
            body=body.content,
            format=request.format,
            caller=caller,
            settings=self.settings,
            storage=self.storage,
            claim=claim,
            key=request.key,
            reuse=request.reuse,
            quota=self._quota(caller.key_id) if caller.key_id else None,
            lease=self.dispatcher.lease,
            place=place,
        )
        try:
            with tracing.span("enqueue"):
                ended = self.dispatcher.begin_request(claim, ANSWER, task)
        except BaseException as error:
            self.dispatcher.line.release()
            if isinstance(error, EngineError):
                return None
            raise
        began = time.monotonic()
        await self._wait_for(ended, claim.mesh_id, min(request.seconds, self.settings.max_wait))
        if _was_taken_away(ended) and not self.wakeups.closing:
            return AcceptedMesh(claim.mesh_id, None, time.monotonic() - began)
        if await self._is_entered(ended, claim.mesh_id):
            return AcceptedMesh(claim.mesh_id, ended, time.monotonic() - began)
        if _was_taken_away(ended) or ended.exception() is not None:
            is_stored = await self._is_stored(claim.mesh_id)
            return AcceptedMesh(claim.mesh_id, None, time.monotonic() - began) if is_stored else None
        if isinstance(end := ended.result(), NoMesh):
            return await self._conclude(end, caller, request)
        return AcceptedMesh(claim.mesh_id, ended)

    async def _is_entered(self, ended: Future[Any], mesh_id: str) -> bool:
        """Whether a worker that still has a mesh has put it into the store; one that does not is stopped."""
        until = time.monotonic() + _MAX_ENTRY_SECONDS
        while not ended.done():
            if await self._is_stored(mesh_id):
                return True
            if time.monotonic() > until:
                self.dispatcher.cancel(mesh_id)
            await self._wait_for(ended, mesh_id, self.settings.poll)
        return False

    def _quota(self, key_id: str) -> Quota:
        """The limits of a key, with the meshes that workers of this service have and the store may not."""
        return self.quotas.mesh_quota(self.dispatcher.in_flight(key_id))

    async def _conclude(self, end: NoMesh, caller: Caller, request: MeshRequest) -> AcceptedMesh | None:
        """The mesh of a request of which its worker has made none; raises the problem of a refusal.

        None for a step that the service has to check.
        """
        if end.error is not None:
            with refusals():
                raise end.error
        if end.earlier:
            return AcceptedMesh(end.earlier)
        if end.admitted is None:
            return None
        return await self._accept_admitted(end.admitted, caller, request)

    async def _is_stored(self, mesh_id: str) -> bool:
        return await run_in_threadpool(self.store.meshes.get, mesh_id) is not None

    async def accept(self, admitted: AdmittedSpec, caller: Caller, request: MeshRequest) -> AcceptedMesh:
        """Put an admitted spec into the queue, or answer it with an earlier mesh.

        The step of a sequence goes to a worker at once when its request waits for it. Raises 406, 409, 422 and 429
        problems.
        """
        if request.format is not None:
            check_format(request.format, admitted.spec)
        key, step, seconds = request.key, request.step, request.seconds
        claim = _new_claim(caller)
        new = admitted.new_mesh(claim, request.format)
        if step is not None:
            new = replace(new, fingerprint=None)  # its points depend on earlier steps, and it has its own fields
        if request.reuse and self.settings.reuse:
            with refusals():
                again = await run_in_threadpool(self._reuse, admitted, new, request)
            if again is not None:
                log_context.current().mesh_id = again
                return AcceptedMesh(again)
        fingerprint = admitted.fingerprint(request.format) if step is None else step.fingerprint
        repeated = await self._find_repeated(new, key, fingerprint)
        if repeated is not None:  # a repeated request adds no work
            log_context.current().mesh_id = repeated
            return AcceptedMesh(repeated)
        line, longest = self.dispatcher.line, min(seconds, MAX_LINE_SECONDS)
        may_wait = step is not None and seconds > 0
        reserved = may_wait and await line.obtain(caller.key_id, caller.share, longest)
        stopwatch.lap("store")
        try:
            lease = self.dispatcher.lease if reserved else None
            entry = NewEntry(new=new, samples=admitted.upload, key=key, fingerprint=fingerprint)
            accepted = await self._add(admitted, request, entry, claim, lease)
        except BaseException:
            if reserved:
                self.dispatcher.line.release()
            raise
        log_context.current().mesh_id = accepted.mesh_id
        return accepted

    def _reuse(self, admitted: AdmittedSpec, new: NewMesh, request: MeshRequest) -> str | None:
        """A new mesh with the points of an earlier one; None when there is none."""
        if not self.store.meshes.has_equal(new):
            return None
        if admitted.upload is not None:
            self.store.samples.keep(admitted.upload, new.key_id)
        fingerprint = admitted.fingerprint(request.format)
        return self.store.meshes.reuse(new, key=request.key, fingerprint=fingerprint)

    async def _find_repeated(self, new: NewMesh, key: str | None, fingerprint: str) -> str | None:
        """The mesh of an earlier request with this idempotency key."""
        if key is None:
            return None
        with refusals():
            return await run_in_threadpool(self.store.meshes.find_repeated, new.key_id, key, fingerprint)

    async def _add(
        self, admitted: AdmittedSpec, request: MeshRequest, entry: NewEntry, claim: Claim, lease: Lease | None
    ) -> AcceptedMesh:
        step, new = request.step, entry.new
        if lease is None and await run_in_threadpool(self.store.queue.count_waiting) >= self.settings.max_queue:
            raise Problem("queue-full", "Too many meshes are waiting.", headers={"Retry-After": "10"})
        quota = self._quota(new.key_id) if new.key_id else None

        def add() -> str:
            if entry.samples is not None:
                self.store.samples.keep(entry.samples, new.key_id)
            packed = pickle.dumps(admitted.built) if admitted.packed is None and admitted.built else admitted.packed
            if packed is not None:
                self.problems.put(new.id, packed)  # before another thread may give the mesh to a worker
            mesh_id, key, fingerprint = "", entry.key, entry.fingerprint
            try:
                if quota is not None and quota.in_flight:
                    self.store.quotas.check(new.key_id, new.points, partial(self._quota, new.key_id))
                mesh_id = self.store.meshes.add(
                    new, key=key, fingerprint=fingerprint, quota=quota, lease=lease, step=step
                )
            finally:
                if mesh_id != new.id:
                    self.problems.take(new.id)
            return mesh_id

        with tracing.span("enqueue"), refusals():
            mesh_id = await run_in_threadpool(add)
        if lease is None:
            self.dispatcher.wake()
            return AcceptedMesh(mesh_id)
        if mesh_id != new.id:  # an earlier mesh of the same key
            self.dispatcher.line.release()
            return AcceptedMesh(mesh_id)
        mesh_input = MeshInput(spec=admitted.spec, samples=admitted.samples, format=new.format)
        if step is not None:
            fields = None if step.fields is None else step.fields.sha256
            mesh_input = replace(mesh_input, start=step.start, fields=fields, settings=step.settings)
        try:
            return AcceptedMesh(mesh_id, self.dispatcher.begin(claim, mesh_input))
        except EngineError:
            self.dispatcher.line.release()  # the mesh is stored, and the dispatcher will see that no worker has it
            return AcceptedMesh(mesh_id)

    async def wait_for_ending(self, accepted: AcceptedMesh, seconds: float) -> Ending | None:
        """The ending of a mesh that went straight to a worker; None for others, and when ``seconds`` are over first."""
        if accepted.task is None:
            return None
        task = accepted.task
        await self._wait_for(task, accepted.mesh_id, min(seconds, self.settings.max_wait))
        if not task.done() or task.cancelled() or task.exception() is not None:
            return None  # the store has the ending, now or soon
        return task.result() if isinstance(task.result(), Ending) else None

    async def _wait_for(self, task: Future[Any], mesh_id: str, seconds: float) -> None:
        """Wait for the end of a task, or of the service, for at most ``seconds``."""
        # Not by `asyncio.wrap_future`, which logs an exception that comes after the last waiter has left.
        deadline = time.monotonic() + seconds
        while not task.done() and (left := deadline - time.monotonic()) > 0 and not self.wakeups.closing:
            await self.wakeups.wait(mesh_id, min(left, self.settings.poll))


def _was_taken_away(ended: Future[Any]) -> bool:
    """Whether a mesh was canceled, deleted, or given to another attempt: it was in the store, and may be gone."""
    if not ended.done():
        return False
    error = None if ended.cancelled() else ended.exception()
    return ended.cancelled() or isinstance(error, CancelledError) or (error is None and ended.result() is None)


def _new_claim(caller: Caller) -> Claim:
    """The first attempt at a new mesh, of the current request."""
    return Claim(
        f"m-{secrets.token_hex(10)}",
        1,
        time.time(),
        request_id=log_context.current().request_id or None,
        key_id=caller.key_id,
        trace=tracing.traceparent(),
    )


@contextmanager
def refusals() -> Iterator[None]:
    """Turn the refusals of the store into problems."""
    try:
        yield
    except KeyReusedError:
        raise Problem("idempotency-key-reused", "The key was used for another spec.") from None
    except QuotaError as error:
        raise quota_problem(error) from None
    except StepTakenError:
        detail = "The sequence has taken another step, or the step that this one follows is gone: GET it again."
        raise Problem("conflict", detail) from None
    except SamplesGoneError:
        raise Problem("conflict", "The samples were deleted at this moment; upload them again.") from None
