"""The way of an admitted mesh: it enters the queue, goes straight to a worker, or reuses an earlier mesh."""

from __future__ import annotations

import pickle
import secrets
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from starlette.concurrency import run_in_threadpool

from equimesh.io.formats import FORMATS
from equimesh_service.admission.admit import Admission, AdmittedSpec
from equimesh_service.admission.callers import Caller, Quotas, quota_problem
from equimesh_service.assembly.problem import PackedProblems
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.errors import EngineError, KeyReusedError, QuotaError, SamplesGoneError, StepTakenError
from equimesh_service.problems.problem import Problem, did_you_mean
from equimesh_service.settings import Settings
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import (
    Claim,
    Draft,
    Ending,
    Lease,
    MeshInput,
    NewMesh,
    NewStep,
    RefusedDraft,
    RepeatedDraft,
)
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, stopwatch, tracing
from equimesh_service.worker.in_parts import HEADED, PART_FORMATS

# Which formats a mesh is requested in: those of whole meshes, and those of meshes in parts.


def known_format(name: str) -> str:
    """The name of a format of meshes, whole or in parts, checked; raises a 406 problem."""
    known = [*FORMATS, *(head for head in HEADED if head not in FORMATS)]
    if name not in known:
        near = did_you_mean(name, known) or "."
        raise Problem("not-acceptable", f"{name[:40]!r} is not a mesh format; there are {', '.join(known)}{near}")
    return name


def check_format(format: str, spec: Mapping[str, Any]) -> None:
    """Raise a 406 problem for a format in which the mesh of a canonical spec is no file."""
    if spec["parts"] is None:
        is_grid = spec.get("domain", {}).get("kind") not in ("blocks", "mesh")
        check_whole(format, spec["cells"], is_grid=is_grid)
    else:
        check_head(format)


def check_whole(format: str, cells: str, *, is_grid: bool = True) -> None:
    """Raise a 406 problem for a format that no whole mesh has, or that does not hold these cells, or no blocks."""
    if format not in FORMATS:
        detail = f"A {format} file is the head of a mesh in parts, and this mesh is whole."
        raise Problem("not-acceptable", f"{detail} Request one of {', '.join(FORMATS)}.")
    if not is_grid and FORMATS[format].grids_only:
        known = ", ".join(name for name, form in FORMATS.items() if not form.grids_only)
        raise Problem("not-acceptable", f"A {format} file is a grid, and this mesh has blocks. Request one of {known}.")
    if cells not in FORMATS[format].cells:
        raise Problem("not-acceptable", f"A {format} file holds no {cells}s. Request cells=quad or another format.")


def check_head(format: str, cells: str = "quad") -> None:
    """Raise a 406 problem for a format in which a mesh in parts has no head."""
    if format not in HEADED:
        raise Problem("not-acceptable", f"A mesh in parts is no {format} file. Request one of {', '.join(HEADED)}.")
    if cells != "quad":
        raise Problem("not-acceptable", "The files of a mesh in parts hold quadrilaterals. Request cells=quad.")


def check_part(format: str) -> None:
    """Raise a 406 problem for a format in which there are no parts."""
    if format not in PART_FORMATS:
        near = did_you_mean(format, PART_FORMATS) or "."
        detail = f"{format[:40]!r} is not a format of parts; there are {', '.join(PART_FORMATS)}{near}"
        raise Problem("not-acceptable", detail)


# The longest wait of a request in the line for a worker. After it the mesh enters the queue, which survives a crash.
MAX_LINE_SECONDS = 1.0
# A draft that takes longer is entered into the store, where it can be listed, canceled and retried.
MAX_DRAFT_SECONDS = 0.05


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
    """A mesh that is in the store, and the task of its worker where it went straight to one."""

    mesh_id: str
    task: Future[Any] | None = None


@dataclass(frozen=True)
class Intake:
    """Puts admitted meshes into the store, and into the queue or to a worker."""

    settings: Settings
    store: Store
    admission: Admission
    dispatcher: Dispatcher
    wakeups: Wakeups
    quotas: Quotas
    problems: PackedProblems

    async def accept(self, admitted: AdmittedSpec, caller: Caller, request: MeshRequest) -> AcceptedMesh:
        """Put an admitted spec into the queue, or give it to a worker at once when the request waits for it.

        Raises 406, 409, 422 and 429 problems.
        """
        if request.format is not None:
            check_format(request.format, admitted.spec)
        key, step, seconds = request.key, request.step, request.seconds
        new = _new_mesh(admitted, caller, request.format)
        if step is not None:
            new = replace(new, fingerprint=None)  # its points depend on earlier steps, and it has its own fields
        if request.reuse and self.settings.reuse:
            with refusals():
                again = await run_in_threadpool(self._reuse, admitted, caller, new, request)
            if again is not None:
                log_context.current().mesh_id = again
                return AcceptedMesh(again)
        fingerprint = admitted.fingerprint(request.format) if step is None else step.fingerprint
        repeated = await self._find_repeated(new, key, fingerprint)
        if repeated is not None:  # a repeated request adds no work
            log_context.current().mesh_id = repeated
            return AcceptedMesh(repeated)
        line, longest = self.dispatcher.line, min(seconds, MAX_LINE_SECONDS)
        reserved = seconds > 0 and await line.obtain(caller.key_id, caller.share, longest)
        stopwatch.lap("store")
        lease = self.dispatcher.lease if reserved else None
        if lease is not None and step is None and admitted.built is not None and not admitted.is_in_parts:
            draft = Draft(new=new, built=admitted.built, samples=admitted.upload, key=key, fingerprint=fingerprint)
            accepted = await self._begin_draft(draft, admitted, caller)
            if accepted is None:  # its worker was lost
                accepted = await self._follow(draft, admitted, caller, request)
        else:
            try:
                accepted = await self._add(admitted, caller, request, new, fingerprint, lease)
            except BaseException:
                if lease is not None:
                    self.dispatcher.line.release()
                raise
        log_context.current().mesh_id = accepted.mesh_id
        return accepted

    def _reuse(self, admitted: AdmittedSpec, caller: Caller, new: NewMesh, request: MeshRequest) -> str | None:
        """A new mesh with the points of an earlier one; None when there is none."""
        if not self.store.meshes.has_equal(new):
            return None
        self.admission.keep_upload(admitted, caller)
        fingerprint = admitted.fingerprint(request.format)
        return self.store.meshes.reuse(new, key=request.key, fingerprint=fingerprint)

    async def _begin_draft(self, draft: Draft, admitted: AdmittedSpec, caller: Caller) -> AcceptedMesh | None:
        """Give a draft to the reserved worker, and enter it into the store when it is not finished soon.

        None when no worker has it, and the store does not know it.
        """
        new, quota = draft.new, self.quotas.mesh_quota(caller)
        try:
            if quota is not None:
                with refusals():
                    await run_in_threadpool(self.store.quotas.check, new.key_id, new.points, quota)
            mesh_input = MeshInput(spec=new.spec, samples=admitted.samples, format=new.format, draft=draft)
            claim = Claim(new.id, 1, time.time(), 0.0, new.request_id, new.key_id, new.trace)
            with tracing.span("enqueue"):
                task = self.dispatcher.begin(claim, mesh_input)
        except EngineError:
            self.dispatcher.line.release()
            return None
        except BaseException:
            self.dispatcher.line.release()
            raise
        await self._wait_for(task, new.id, MAX_DRAFT_SECONDS)
        if not task.done():
            return await self._enter(draft, admitted, caller, quota, task)
        if task.cancelled() or task.exception() is not None:
            return None
        match task.result():
            case Ending():
                return AcceptedMesh(new.id, task)
            case RepeatedDraft(mesh_id):
                return AcceptedMesh(mesh_id)
            case RefusedDraft(error):
                with refusals():
                    raise error
        return None

    async def _follow(self, draft: Draft, admitted: AdmittedSpec, caller: Caller, request: MeshRequest) -> AcceptedMesh:
        """The mesh of a draft whose worker was lost: it is in the store if the worker got so far, else it waits."""
        if await run_in_threadpool(self.store.drafts.exists, draft.new.id):
            return AcceptedMesh(draft.new.id)
        # Under another id, since the dispatcher may still have the claim of the lost attempt.
        new = replace(draft.new, id=_new_id())
        return await self._add(admitted, caller, request, new, draft.fingerprint, None)

    async def _enter(
        self, draft: Draft, admitted: AdmittedSpec, caller: Caller, quota: Quota | None, task: Future[Any]
    ) -> AcceptedMesh:
        """Put a draft into the store while a worker has it; without a place there, its worker is stopped."""
        new = draft.new

        def enter() -> str:
            self.admission.keep_upload(admitted, caller)
            return self.store.drafts.enter(draft, self.dispatcher.lease, quota)

        mesh_id = ""
        try:
            with refusals():
                mesh_id = await run_in_threadpool(enter)
        finally:
            if mesh_id == new.id:
                self.dispatcher.note_entered(new.id)
            else:
                self.dispatcher.cancel(new.id)
        return AcceptedMesh(mesh_id, task) if mesh_id == new.id else AcceptedMesh(mesh_id)

    async def _find_repeated(self, new: NewMesh, key: str | None, fingerprint: str) -> str | None:
        """The mesh of an earlier request with this idempotency key."""
        if key is None:
            return None
        with refusals():
            return await run_in_threadpool(self.store.meshes.find_repeated, new.key_id, key, fingerprint)

    async def _add(
        self,
        admitted: AdmittedSpec,
        caller: Caller,
        request: MeshRequest,
        new: NewMesh,
        fingerprint: str,
        lease: Lease | None,
    ) -> AcceptedMesh:
        step = request.step
        if lease is None and await run_in_threadpool(self.store.queue.count_waiting) >= self.settings.max_queue:
            raise Problem("queue-full", "Too many meshes are waiting.", headers={"Retry-After": "10"})
        quota = self.quotas.mesh_quota(caller)

        def add() -> str:
            self.admission.keep_upload(admitted, caller)
            packed = pickle.dumps(admitted.built) if admitted.packed is None and admitted.built else admitted.packed
            if packed is not None:
                self.problems.put(new.id, packed)  # before another thread may give the mesh to a worker
            mesh_id = ""
            try:
                mesh_id = self.store.meshes.add(
                    new, key=request.key, fingerprint=fingerprint, quota=quota, lease=lease, step=step
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
        claim = Claim(mesh_id, 1, time.time(), 0.0, new.request_id, new.key_id, new.trace)
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


def _new_id() -> str:
    return f"m-{secrets.token_hex(10)}"


def _new_mesh(admitted: AdmittedSpec, caller: Caller, format: str | None) -> NewMesh:
    return NewMesh(
        id=_new_id(),
        spec=admitted.spec,
        samples=tuple(admitted.samples),
        format=format,
        key_id=caller.key_id,
        request_id=log_context.current().request_id or None,
        trace=tracing.traceparent(),
        fingerprint=admitted.points_fingerprint,
        nodes=admitted.nodes,
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
