"""The engine on a cluster: each job is a task of Dask, which a pool of processes on its worker runs.

A thread with an event loop follows the cluster. It knows the workers, gives each job to one of them, and connects again
when the scheduler was lost. Jobs wait here until a worker has a free process.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Callable, Coroutine, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar
from uuid import uuid4

from distributed import Client
from distributed.scheduler import KilledWorker

from equimesh_service.engine.cluster_pool import (
    PoolReport,
    describe_difference,
    run_in_pool,
    versions,
    visit,
)
from equimesh_service.engine.port import Health, PackedCall, PoolSettings, open_outcome
from equimesh_service.errors import EngineError, SchedulerLostError, WorkerLostError

# A worker without a sign of life for this time is taken for lost; it sends one every half second, or every few.
MAX_SILENT_SECONDS = 20.0
# The time between two visits of a worker.
VISIT_SECONDS = 20.0
# The most workers that a sentence names.
_MAX_NAMED = 3
_RUNNING = "running"  # the status of Dask


@dataclass(eq=False)
class Member:
    """A worker, by its address. ``refusal`` is the reason why it is not used, "" while it starts."""

    address: str
    name: str
    report: PoolReport | None = None
    refusal: str = ""
    jobs: set[str] = field(default_factory=set)  # the keys of the jobs that it has
    seen: float = 0.0  # its last sign of life, by the clock of the scheduler
    heard: float = field(default_factory=time.monotonic)  # when that came, by the clock here
    visit_at: float = 0.0  # when to visit it next

    @property
    def slots(self) -> int:
        """The number of jobs that it may have at the same time."""
        return self.report.slots if self.report is not None and self.report.ready and not self.refusal else 0

    @property
    def free(self) -> int:
        """The number of further jobs that it may have now."""
        return self.slots - len(self.jobs)

    def note_visit(self, error: Exception | None) -> None:
        """Note the end of a visit."""
        self.visit_at = time.monotonic() + VISIT_SECONDS
        if error is not None:
            self.report = None
        if isinstance(error, ModuleNotFoundError):
            self.refusal = f"it has no equimesh of this release ({error})"
        elif error is not None:
            self.refusal = f"it does not answer as expected ({type(error).__name__}: {error})"


class Members:
    """All workers of a cluster; ``here`` are the versions of the service, ``pool`` is the name of its pools."""

    def __init__(self, here: Mapping[str, str], pool: str) -> None:
        self._here, self._pool = here, pool
        self._members: dict[str, Member] = {}

    def __iter__(self) -> Iterator[Member]:
        return iter([*self._members.values()])

    def __len__(self) -> int:
        return len(self._members)

    def update(self, found: Mapping[str, Mapping[str, Any]]) -> list[Member]:
        """Update the workers from the scheduler's records, by address; returns the workers that are gone."""
        gone = [one for one in self if one.address not in found]
        for address, known in found.items():
            member = self._members.get(address)
            if member is not None and (_is_another(member, known, self._pool) or _is_silent(member, known)):
                gone.append(member)
                member = None
            if member is None:
                member = self._members[address] = Member(address, str(known["name"]))
            self._note(member, known)
        for member in gone:
            if self._members.get(member.address) is member:
                del self._members[member.address]
        return gone

    def _note(self, member: Member, known: Mapping[str, Any]) -> None:
        if known["last_seen"] != member.seen:
            member.seen, member.heard = known["last_seen"], time.monotonic()
        packed = known["metrics"].get(self._pool)
        if packed is None:
            if member.report is not None:  # its pool was closed
                member.report, member.visit_at = None, 0.0
            return
        member.report = PoolReport.of(packed)
        different = describe_difference(self._here, member.report.versions)
        member.refusal = f"it has {different}" if different else member.report.fault
        if not member.refusal and known["status"] != _RUNNING:
            member.refusal = f"it is {known['status']}"

    def clear(self) -> None:
        """Forget all workers."""
        self._members.clear()

    def find_free(self) -> Member | None:
        """The worker with the most free processes; None when no worker has any."""
        best = max(self, key=lambda one: one.free, default=None)
        return best if best is not None and best.free > 0 else None

    def find_unvisited(self) -> list[Member]:
        """The workers that are to be visited now."""
        now = time.monotonic()
        return [one for one in self if one.visit_at <= now]

    @property
    def slots(self) -> int:
        """The number of jobs that the workers may have at the same time."""
        return sum(one.slots for one in self)

    def refusals(self) -> list[str]:
        """A clause for each worker that is not used."""
        return [f"worker {one.name} is not used: {one.refusal}" for one in self if one.refusal]

    def describe(self) -> str:
        """The fault of the workers in a sentence; "" where there is none."""
        refusals = self.refusals()
        if refusals:
            more = len(refusals) - _MAX_NAMED
            return "; ".join(refusals[:_MAX_NAMED]) + (f"; and {more} more" if more > 0 else "")
        if self.slots:
            return ""
        return "workers are starting" if self._members else "there are no workers"


def _is_another(member: Member, known: Mapping[str, Any], pool: str) -> bool:
    """Whether another process has the address of a worker now."""
    packed = known["metrics"].get(pool)
    return member.report is not None and packed is not None and packed.get("identity") != member.report.identity


def _is_silent(member: Member, known: Mapping[str, Any]) -> bool:
    return known["last_seen"] == member.seen and time.monotonic() - member.heard > MAX_SILENT_SECONDS


Result = TypeVar("Result")
_log = logging.getLogger(__name__)
# The time between two looks at the workers of the cluster; longer when there are many.
_LOOK_SECONDS = 0.25
_MANY_WORKERS = 50
# A scheduler that does not answer for this time is taken for lost.
_MAX_SILENT_SECONDS = 10.0
# The time between two attempts to connect to the scheduler, and the longest of one.
_CONNECT_AGAIN_SECONDS = 0.5
_MAX_CONNECT_SECONDS = 5.0
_CONNECTED = "running"  # the status of Dask
# The longest wait for the end of a connection.
_MAX_CLOSE_SECONDS = 2.0


@dataclass(eq=False)
class _Job:
    """A job: its call, and from its start on its worker and its task there."""

    key: str
    call: PackedCall
    time_limit: float | None
    outer: Future[Any]
    member: Member | None = None
    following: asyncio.Task[None] | None = None


class DaskEngine:
    """Runs jobs on the workers of the cluster with this ``scheduler``, in pools with these ``settings``.

    Workers may join and leave at any time. Those that differ from this process in their versions, or cannot reach what
    the jobs need, get no jobs; :meth:`health` names them.
    """

    def __init__(self, scheduler: str, settings: PoolSettings) -> None:
        # The engine reports itself what becomes of its connection.
        logging.getLogger("distributed").setLevel(logging.WARNING)
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        self.scheduler = scheduler
        self._settings = settings
        self._members = Members(versions(), settings.name)
        self._jobs: dict[Future[Any], _Job] = {}  # in the order in which they came
        self._client: Any = None  # of Dask, while the scheduler can be reached
        self._lock = threading.Lock()
        self._closed = False
        self._health = Health(ready=False, workers=0, detail=f"connecting to the scheduler at {scheduler}")
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._background: set[asyncio.Task[Any]] = set()
        self._thread = threading.Thread(target=self._run, name="equimesh-cluster", daemon=True)
        self._thread.start()

    def submit(
        self, function: Callable[..., Result], *arguments: Any, time_limit: float | None = None
    ) -> Future[Result]:
        """Run ``function(*arguments)`` on a worker; see :class:`~equimesh_service.engine.port.Engine`."""
        outer: Future[Result] = Future()
        outer.set_running_or_notify_cancel()
        job = _Job(f"equimesh-job-{uuid4().hex}", PackedCall.of(function, *arguments), time_limit, outer)
        self._call(self._accept, job)
        return outer

    def cancel(self, task: Future[Any]) -> None:
        """Give up the task; a process that runs it is killed and replaced."""
        with suppress(EngineError):  # all tasks of a closed engine are given up
            self._call(self._cancel, task)

    def health(self) -> Health:
        """Ready while a worker can be used; ``workers`` is the number of jobs that may run at the same time."""
        return self._health

    def close(self) -> None:
        """Give up all jobs, and leave the cluster."""
        with suppress(EngineError):
            self._call(self._stop.set)
        with self._lock:
            self._closed = True
        self._thread.join()
        self._health = Health(ready=False, workers=0, detail="the engine is closed")

    def _call(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function in the thread of the engine."""
        with self._lock:
            if self._closed:
                raise EngineError("the engine is closed")
            self._loop.call_soon_threadsafe(function, *arguments)

    # All that follows runs in the thread of the engine.

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._serve())
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        except Exception:
            _log.exception("the engine failed")
        finally:
            self._loop.close()

    async def _serve(self) -> None:
        """Stay connected to the scheduler until the engine is closed."""
        while not self._stop.is_set():
            try:
                client = await self._connect()
            except Exception as error:
                self._note(f"{self._unreachable} ({type(error).__name__})")
                await self._pause(_CONNECT_AGAIN_SECONDS)
                continue
            self._client = client
            try:
                await self._follow(client)
            except Exception as error:
                _log.warning("%s: %s: %s", self._unreachable, type(error).__name__, error)
            finally:
                self._lose_all()
                await self._disconnect(client)
        with self._lock:
            self._closed = True
        for job in [*self._jobs.values()]:
            self._end(job, error=CancelledError())
        if self._background:
            await asyncio.wait(self._background, timeout=_MAX_CLOSE_SECONDS)

    async def _connect(self) -> Any:
        client: Any = Client(
            self.scheduler,
            asynchronous=True,
            set_as_default=False,
            timeout=_MAX_CONNECT_SECONDS,
            direct_to_workers=False,
            name="equimesh-service",
        )
        try:
            return await client
        except BaseException:
            await self._disconnect(client)
            raise

    async def _disconnect(self, client: Any) -> None:
        with suppress(Exception):
            await asyncio.wait_for(client.close(timeout=_MAX_CLOSE_SECONDS), 2.0 * _MAX_CLOSE_SECONDS)

    async def _follow(self, client: Any) -> None:
        """Look at the workers again and again; raises when the scheduler is lost."""
        while not self._stop.is_set():
            found = await self._ask(client)
            for member in self._members.update(found["workers"]):
                self._lose(member)
            for member in self._members.find_unvisited():
                member.visit_at = float("inf")
                self._start(self._visit(client, member))
            self._refresh()
            await self._pause(_LOOK_SECONDS * max(1.0, len(self._members) / _MANY_WORKERS))

    async def _ask(self, client: Any) -> dict[str, Any]:
        """The scheduler's record of the cluster; raises when the scheduler is lost."""
        answer = self._loop.create_task(client.scheduler.identity(n_workers=-1))
        began = self._loop.time()
        try:
            while not answer.done():
                await asyncio.wait([answer], timeout=_LOOK_SECONDS)
                # A new connection is tried for long, when the old one is known to be lost.
                if client.status != _CONNECTED or self._loop.time() - began > _MAX_SILENT_SECONDS:
                    raise ConnectionError("it does not answer")
            found: dict[str, Any] = answer.result()
            return found
        finally:
            answer.cancel()

    async def _visit(self, client: Any, member: Member) -> None:
        """Let a worker open its pool, or keep it open."""
        error = None
        try:
            answers = await client.run(visit, self._settings, workers=[member.address], on_error="return")
            error = answers[member.address]
        except Exception as failure:  # also KeyError: the worker has just left
            error = failure
        member.note_visit(error)

    def _refresh(self) -> None:
        """Note the state of the cluster, and start jobs that wait."""
        detail = self._members.describe()
        self._note(f"the cluster at {self.scheduler}: {detail}" if detail else "")
        self._assign()

    def _note(self, detail: str) -> None:
        slots = self._members.slots
        before, self._health = self._health, Health(ready=slots > 0, workers=slots, detail=detail)
        if (slots, detail) != (before.workers, before.detail):
            level = logging.INFO if slots else logging.WARNING
            _log.log(level, "room for %d jobs on the cluster%s", slots, f"; {detail}" if detail else "")

    @property
    def _unreachable(self) -> str:
        return f"the scheduler at {self.scheduler} cannot be reached"

    def _accept(self, job: _Job) -> None:
        self._jobs[job.outer] = job
        self._assign()

    def _assign(self) -> None:
        """Give waiting jobs to workers with free processes."""
        for job in [*self._jobs.values()]:
            if job.member is None:
                member = self._members.find_free() if self._client is not None else None
                if member is None:
                    return
                job.member = member
                member.jobs.add(job.key)
                job.following = self._start(self._take(self._client, job, member))

    async def _take(self, client: Any, job: _Job, member: Member) -> None:
        """Run a job on a worker, and pass on its outcome."""
        assert member.report is not None
        arguments = (self._settings.name, member.report.identity, job.key, job.call, job.time_limit)
        task = client.submit(
            run_in_pool, *arguments, key=job.key, workers=[member.address], allow_other_workers=False, pure=False
        )
        try:
            result = open_outcome(await task)
        except asyncio.CancelledError:  # the job has ended in another way
            raise
        except CancelledError as error:  # of Dask, or of a pool that was closed
            if client.status == _CONNECTED:  # otherwise the scheduler is lost, and all jobs with it
                self._end(job, error=SchedulerLostError(f"the cluster gave up the task: {error}"))
        except KilledWorker:
            self._end(job, error=WorkerLostError(f"worker {member.name} of the cluster is gone"))
        except Exception as error:
            self._end(job, error=error)
        else:
            self._end(job, result=result)
        finally:
            task.release()

    def _cancel(self, outer: Future[Any]) -> None:
        job = self._jobs.get(outer)
        if job is not None:
            self._end(job, error=CancelledError())

    def _lose(self, member: Member) -> None:
        """Report the jobs of a worker that is gone."""
        for job in [*self._jobs.values()]:
            if job.member is member:
                self._end(job, error=WorkerLostError(f"worker {member.name} of the cluster is gone"))

    def _lose_all(self) -> None:
        """Report all jobs that were begun, since the scheduler is lost; a closed engine gives up the others, too."""
        self._client = None
        self._members.clear()
        closing = self._stop.is_set()
        if not closing:
            self._note(self._unreachable)
        for job in [*self._jobs.values()]:
            if closing or job.member is not None:
                self._end(job, error=CancelledError() if closing else SchedulerLostError(self._unreachable))

    def _end(self, job: _Job, *, result: Any = None, error: BaseException | None = None) -> None:
        """End a job once; its task is cancelled unless it has ended by itself."""
        if self._jobs.pop(job.outer, None) is None:
            return
        if job.member is not None:
            job.member.jobs.discard(job.key)
        if job.following is not None and job.following is not asyncio.current_task():
            job.following.cancel()
        try:
            if error is None:
                job.outer.set_result(result)
            else:
                job.outer.set_exception(error)
        finally:
            self._assign()

    async def _pause(self, seconds: float) -> None:
        """Wait; not for long when the engine is closed."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._stop.wait(), seconds)

    def _start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(work)
        self._background.add(task)
        task.add_done_callback(self._background.discard)
        return task
