"""Previews: meshes that a reserved worker solves at once, and of which nothing is kept."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar

from equimesh.specs.spec import BuiltSpec
from equimesh_service.admission.admit import Admission, Admitted
from equimesh_service.admission.callers import Caller
from equimesh_service.assembly import samples as intake
from equimesh_service.assembly.bodies import MAX_SHORT_BYTES, ShortSpec
from equimesh_service.assembly.samples import Upload
from equimesh_service.dispatch.wakeups import CheckThreads
from equimesh_service.dispatch.worker_line import WorkerLine
from equimesh_service.engine.port import Engine
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError
from equimesh_service.files.port import StoredFile
from equimesh_service.problems.problem import Problem, repointed
from equimesh_service.settings import Settings
from equimesh_service.spec.document import parse, sent_pointer
from equimesh_service.spec.mesh import CheckedSpec
from equimesh_service.store.rows import SamplesRow
from equimesh_service.telemetry import log_context, stopwatch, tracing
from equimesh_service.worker.job import Storage
from equimesh_service.worker.preview import Preview, draw_preview


@dataclass(frozen=True)
class PreviewAdmission(Admission):
    """Checks one request for a preview. ``sent`` gets the samples that came with it, as npz files by their ids.

    A monitor that takes long to check is checked by the worker that solves.
    """

    product: ClassVar[str] = "a preview"
    sent: dict[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(cls, admission: Admission) -> PreviewAdmission:
        """The checks with the limits of previews."""
        settings = admission.settings
        most = min(settings.max_points, settings.max_preview_points)
        limits = settings.model_copy(update={"max_points": most, "max_cluster_points": 0})
        return cls(
            settings=limits,
            store=admission.store,
            files=admission.files,
            side_workers=admission.side_workers,
            while_waiting=admission.while_waiting,
        )

    @property
    def _way_to_more(self) -> str:
        return "; request the mesh itself (POST /v1/meshes), which may have more"

    def _admit(self, short: ShortSpec, upload: Upload | None, caller: Caller, mesh: Upload | None = None) -> Admitted:
        return super()._admit(replace(short, spec=short.spec.whole()), upload, caller, mesh)

    def _check(self, spec: CheckedSpec, rows: Any, sent: Any) -> tuple[BuiltSpec | None, bytes | None]:
        return super()._check(spec, rows, sent) if spec.is_quick else (None, None)

    def _keep(self, path: Path, summary: dict[str, Any], caller: Caller, *, durable: bool) -> tuple[SamplesRow, bool]:  # noqa: ARG002
        content = path.read_bytes()
        row = intake.row_of(StoredFile(sha256(content).hexdigest(), len(content)), summary, self.store.clock())
        self.sent[row.id] = content
        return row, True


# The longest wait for a worker.
MAX_LINE_SECONDS = 1.0
# A solve that has not ended itself for this time after its limit is killed, with its worker.
_MAX_STEP_SECONDS = 1.0
# The time that an engine has after that. A worker that takes the place of a killed one warms up first.
_MAX_REPORT_SECONDS = 30.0
_REQUEST_THE_MESH = "Request the mesh itself with POST /v1/meshes, or fewer points."


@dataclass(frozen=True)
class Previews:
    """Gives previews to workers. ``admission`` is that of previews, of which each request takes its own."""

    settings: Settings
    storage: Storage
    admission: PreviewAdmission
    check_threads: CheckThreads
    engine: Engine
    line: WorkerLine

    async def draw(
        self,
        document: bytes,
        upload: Upload | None,
        caller: Caller,
        *,
        mesh: Upload | None = None,
        frames: bool,
        has_left: Callable[[], Awaitable[bool]],
    ) -> bytes | None:
        """The drawing of the mesh of a spec; None for a caller who ``has_left`` before a worker was free.

        Raises the problems of a spec that is refused, and 409, 429 and 503 problems.
        """
        admission = replace(self.admission, sent={})
        admitted = await self.check_threads.run(admission.receive, document, upload, caller, mesh)
        stopwatch.lap("check")
        preview = self._task(admitted, admission.sent, frames=frames)
        task = await self._begin(preview, caller, has_left)
        if task is None:
            return None
        stopwatch.lap("line")
        try:
            with tracing.span("preview"):
                return await self._finish(task)
        except Problem as problem:
            if not problem.errors or len(document) > MAX_SHORT_BYTES:
                raise
            raise repointed(problem, partial(sent_pointer, parse(document))) from None

    async def _begin(
        self, preview: Preview, caller: Caller, has_left: Callable[[], Awaitable[bool]]
    ) -> Future[bytes] | None:
        """The task of a worker, which is free when the task ends, however the request does."""
        if not await self.line.obtain(caller.key_id, caller.share, MAX_LINE_SECONDS):
            detail = f"All workers are busy, and none was free within {MAX_LINE_SECONDS:g} s."
            raise Problem("workers-busy", detail, headers={"Retry-After": "1"})
        task = None
        try:
            if not await has_left():
                limit = self.settings.preview_seconds + _MAX_STEP_SECONDS
                task = self.engine.submit(draw_preview, preview, time_limit=limit)
                self.line.occupy(task, caller.key_id)
        except EngineError as error:
            raise _lost(error) from None
        finally:
            if task is None:
                self.line.release()
        return task

    def _task(self, admitted: Admitted, sent: dict[str, bytes], *, frames: bool) -> Preview:
        new = admitted.upload
        sent = {**sent} if new is None else {**sent, new.row.id: new.archive}
        return Preview(
            spec=admitted.spec,
            storage=self.storage,
            built=admitted.built,
            packed=admitted.packed,
            stored={name: sha256 for name, sha256 in admitted.samples.items() if name not in sent},
            sent={} if admitted.built is not None or admitted.packed is not None else sent,
            frames=frames,
            seconds=self.settings.preview_seconds,
            threads=self.settings.worker_threads,
            request_id=log_context.current().request_id,
        )

    async def _finish(self, task: Future[bytes]) -> bytes:
        """The drawing, once the worker has it."""
        limit = self.settings.preview_seconds
        try:
            async with asyncio.timeout(limit + _MAX_STEP_SECONDS + _MAX_REPORT_SECONDS):
                return await asyncio.wrap_future(task)
        except TimeLimitError:
            detail = f"The preview was not finished within {limit:g} s (EQUIMESH_PREVIEW_SECONDS)."
            raise Problem("time-limit", detail, remedy=_REQUEST_THE_MESH) from None
        except MemoryLimitError:
            detail = f"The preview needs more than {self.settings.memory_limit} MiB of memory."
            raise Problem("memory-limit", detail) from None
        except EngineError as error:
            raise _lost(error) from None
        except asyncio.CancelledError as error:
            here = asyncio.current_task()
            if here is None or here.cancelling():
                raise  # the request is given up, not the task
            raise _lost(error) from None
        except TimeoutError as error:
            self.engine.cancel(task)
            raise _lost(error) from None


def _lost(error: BaseException) -> Problem:
    detail = f"The preview was not drawn: {str(error) or 'its worker does not answer'}."
    return Problem("unavailable", detail, headers={"Retry-After": "1"})
