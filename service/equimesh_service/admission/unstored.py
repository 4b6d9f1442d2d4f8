"""Meshes that a reserved worker computes at once and that are not kept: previews, and requests with store=false."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass

from equimesh_service.admission.callers import Caller
from equimesh_service.admission.tasks import COMPUTE, Computation, ComputationResult
from equimesh_service.dispatch.worker_line import WorkerLine
from equimesh_service.engine.port import Engine
from equimesh_service.errors import EngineError, MemoryLimitError, TimeLimitError
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import Settings
from equimesh_service.telemetry import log_context, stopwatch, tracing
from equimesh_service.worker.job import DRAWING, Storage

# The longest wait for a worker.
MAX_LINE_SECONDS = 1.0
# A solve that has not ended itself for this time after its limit is killed, with its worker.
_MAX_STEP_SECONDS = 1.0
# The time that an engine has after that. A worker that takes the place of a killed one warms up first.
_MAX_REPORT_SECONDS = 30.0
# The time in which a mesh may still be finished whose caller has left: to replace a killed worker takes as long.
_MAX_UNWANTED_SECONDS = 0.2


@dataclass(frozen=True)
class UnstoredMeshes:
    """Gives requests to workers as they came, and the answers back."""

    settings: Settings
    storage: Storage
    engine: Engine
    line: WorkerLine

    async def compute(
        self,
        body: bytes,
        content_type: str,
        caller: Caller,
        *,
        format: str | None,
        seconds: float,
        frames: bool = False,
        leaves: Callable[[], Awaitable[None]],
    ) -> ComputationResult | None:
        """The answer in a ``format`` of :class:`~equimesh_service.admission.tasks.Computation`.

        It takes at most ``seconds``. ``leaves`` returns when the caller has left: the work ends then, and there is no
        answer, None. Raises the problems of a request that is refused, and 409, 429 and 503 problems.
        """
        computation = Computation(
            content_type=content_type,
            body=body,
            format=format,
            frames=frames,
            caller=caller,
            settings=self.settings,
            storage=self.storage,
            seconds=seconds,
            request_id=log_context.current().request_id,
        )
        left = asyncio.ensure_future(leaves())
        try:
            task = await self._begin(computation, left)
            if task is None:
                return None
            stopwatch.lap("line")
            with tracing.span("preview" if format == DRAWING else "unstored mesh"):
                computed = await self._finish(task, computation, left)
        finally:
            left.cancel()
        if computed is not None:
            stopwatch.include(computed.ending.laps)
            stopwatch.lap("hand-over")
        return computed

    async def _begin(self, computation: Computation, left: asyncio.Future[None]) -> Future[ComputationResult] | None:
        """The task of a worker, which is free when the task ends, however the request does."""
        caller, task = computation.caller, None
        if not await self.line.obtain(caller.key_id, caller.share, MAX_LINE_SECONDS):
            detail = f"All workers are busy, and none was free within {MAX_LINE_SECONDS:g} s."
            raise Problem("workers-busy", detail, headers={"Retry-After": "1"})
        try:
            if not left.done():
                limit = computation.seconds + _MAX_STEP_SECONDS
                task = self.engine.submit(COMPUTE, computation, time_limit=limit)
                self.line.occupy(task, caller.key_id)
        except EngineError as error:
            raise _lost(error) from None
        finally:
            if task is None:
                self.line.release()
        return task

    async def _finish(
        self, task: Future[ComputationResult], computation: Computation, left: asyncio.Future[None]
    ) -> ComputationResult | None:
        """The answer, once the worker has it; None for a caller who has left."""
        ended, seconds = _end_of(task), computation.seconds
        try:
            limit = seconds + _MAX_STEP_SECONDS + _MAX_REPORT_SECONDS
            await asyncio.wait((ended, left), timeout=limit, return_when=asyncio.FIRST_COMPLETED)
            if left.done() and not task.done():
                await asyncio.wait((ended,), timeout=_MAX_UNWANTED_SECONDS)
                return None
            if not task.done():
                raise _lost(TimeoutError())
            return task.result()
        except TimeLimitError:
            whose = "EQUIMESH_PREVIEW_SECONDS" if computation.format == DRAWING else "EQUIMESH_MAX_WAIT"
            detail = f"The mesh was not finished within {seconds:g} s ({whose})."
            raise Problem("time-limit", detail, remedy=_REQUEST_THE_MESH) from None
        except MemoryLimitError:
            detail = f"The mesh needs more than {self.settings.memory_limit} MiB of memory."
            raise Problem("memory-limit", detail) from None
        except (EngineError, CancelledError) as error:
            raise _lost(error) from None
        finally:
            if not task.done():  # nobody waits for it any more
                self.engine.cancel(task)


_REQUEST_THE_MESH = "Request a mesh that the service keeps, with POST /v1/meshes, or fewer points."


def _end_of(task: Future[ComputationResult]) -> asyncio.Future[None]:
    """A future of this loop that is done when the task is, whatever its outcome."""
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[None] = loop.create_future()

    def note() -> None:
        if not ended.done():
            ended.set_result(None)

    def tell(_: Future[ComputationResult]) -> None:
        with suppress(RuntimeError):  # the loop is closed
            loop.call_soon_threadsafe(note)

    task.add_done_callback(tell)
    return ended


def _lost(error: BaseException) -> Problem:
    detail = f"The mesh was not computed: {str(error) or 'its worker does not answer'}."
    return Problem("unavailable", detail, headers={"Retry-After": "1"})
