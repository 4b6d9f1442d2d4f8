"""One running service: its rooms, how they are opened and closed, and the waits that cross them."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TypeVar

from anyio import CapacityLimiter, to_thread
from starlette.concurrency import run_in_threadpool

from equimesh_service import exports, worker
from equimesh_service.admission import Admission, Admitted
from equimesh_service.dispatcher import Dispatcher, Rules
from equimesh_service.engine import Engine, EngineError, MemoryLimitError, TimeLimitError
from equimesh_service.files import FileStore
from equimesh_service.job import Export, Job, Place
from equimesh_service.pebble_engine import PebbleEngine
from equimesh_service.problems import Problem
from equimesh_service.rows import Artifact, KeyReusedError, MeshRow, NewMesh, SamplesGoneError
from equimesh_service.settings import Settings
from equimesh_service.store import Store
from equimesh_service.wakeups import Wakeups

Checked = TypeVar("Checked")
_log = logging.getLogger(__name__)
# Files, pictures and samples have workers of their own, so that they never wait behind the solves.
_DESK_WORKERS = 2
# Threads that check what clients send.
_CHECKERS = 4
# Modules that workers share the memory and the loading time of.
PRELOAD = (
    "equimesh_service.worker",
    "equimesh_service.exports",
    "equimesh_service.intake",
    "equimesh.plot",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
)


class FolderInUseError(OSError):
    """Another service works in the same data folder."""


@dataclass(kw_only=True)
class Service:
    """The four rooms, opened. ``engine`` solves, ``desk`` makes files and pictures, and reads samples."""

    settings: Settings
    place: Place
    store: Store
    files: FileStore
    engine: Engine
    desk: Engine
    dispatcher: Dispatcher
    wakeups: Wakeups
    admission: Admission
    lock: TextIOWrapper
    checkers: CapacityLimiter
    exporting: dict[Export, Future[Artifact | None]] = field(default_factory=dict)

    async def check(self, function: Callable[..., Checked], *arguments: Any) -> Checked:
        """Run a check of what a client sent, off the event loop.

        Checks may take long (a million samples), so they have a few threads of their own: however many there
        are, the other requests are served.
        """
        return await to_thread.run_sync(function, *arguments, limiter=self.checkers)

    async def mesh(self, mesh_id: str) -> MeshRow:
        """The mesh with this id; raises a 404 problem."""
        row = await run_in_threadpool(self.store.meshes.get, mesh_id)
        if row is None:
            raise Problem("not-found", "There is no mesh with this id.")
        return row

    async def finished(self, mesh_id: str, seconds: float) -> MeshRow:
        """The mesh, once it is finished or after so many seconds; raises a 404 problem."""
        deadline = time.monotonic() + min(seconds, self.settings.max_wait)
        while True:
            row = await self.mesh(mesh_id)
            left = deadline - time.monotonic()
            if row.finished or left <= 0 or self.wakeups.closing:
                return row
            await self.wakeups.wait(mesh_id, min(left, self.settings.poll))

    async def enqueue(self, admitted: Admitted, *, key: str | None, format: str | None) -> str:
        """Put an admitted spec into the queue; returns the id of its mesh."""
        if await run_in_threadpool(self.store.queue.waiting) >= self.settings.max_queue:
            raise Problem("queue-full", "Too many meshes are waiting.", headers={"Retry-After": "10"})
        new = NewMesh(
            id=f"m-{secrets.token_hex(10)}",
            spec=admitted.spec,
            samples=admitted.samples,
            format=format,
        )
        fingerprint = admitted.fingerprint(format)
        try:
            mesh_id = await run_in_threadpool(self.store.meshes.add, new, key=key, fingerprint=fingerprint)
        except KeyReusedError:
            raise Problem("idempotency-key-reused", "The key was used for another spec.") from None
        except SamplesGoneError:
            raise Problem("conflict", "The samples were deleted at this moment; upload them again.") from None
        self.dispatcher.wake()
        return mesh_id

    async def artifact(self, mesh_id: str, name: str) -> Artifact:
        """A file of a finished mesh, made now if it is not there yet."""
        found = await run_in_threadpool(self.store.meshes.artifact, mesh_id, name)
        if found is not None:
            return found
        task = Export(self.place, mesh_id, name)
        future = self.exporting.get(task)
        if future is None:
            future = self.desk.submit(exports.export, task, time_limit=self.settings.time_limit)
            self.exporting[task] = future
            future.add_done_callback(lambda _: self.exporting.pop(task, None))
        try:
            made = await asyncio.wrap_future(future)
        except (TimeLimitError, MemoryLimitError) as error:
            raise Problem("unavailable", f"The file was not made: {error}.") from None
        except (EngineError, CancelledError) as error:
            raise Problem("unavailable", f"The file was not made: {error}.", headers={"Retry-After": "1"}) from None
        if made is None:
            raise Problem("not-found", "There is no mesh with this id.")
        return made

    def file(self, artifact: Artifact) -> Path:
        """Where the bytes of an artifact are."""
        return self.files.path(artifact.sha256)

    def close(self) -> None:
        """Stop the work and close the rooms; what was running goes back into the queue."""
        self.dispatcher.stop()
        self.engine.close()
        self.desk.close()
        self.store.close()
        self.lock.close()


def open_service(settings: Settings) -> Service:
    """Open all rooms, in a running event loop. Raises :class:`FolderInUseError`."""
    folder = settings.data_dir.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    lock = _lock(folder)
    place = Place(f"sqlite:///{folder / 'equimesh.sqlite3'}", folder)
    store, files = Store(place.database_url), place.files()
    store.prepare()
    files.prepare()
    engine = PebbleEngine(settings.workers, memory_limit=settings.memory_limit, preload=PRELOAD, warm_up=worker.warm_up)
    desk = PebbleEngine(_DESK_WORKERS, memory_limit=settings.memory_limit, preload=PRELOAD)
    wakeups = Wakeups()
    rules = Rules(
        time_limit=settings.time_limit,
        memory_limit=settings.memory_limit,
        max_attempts=settings.max_attempts,
        lease=settings.lease,
        poll=settings.poll,
    )
    owner = secrets.token_hex(8)
    dispatcher = Dispatcher(
        owner,
        store,
        engine,
        lambda claim: (worker.solve_mesh, (Job(place, claim, settings.worker_threads),)),
        rules,
        wakeups.announce,
    )
    dispatcher.start(alone=True)
    _log.info("data folder %s, %d workers of %d threads", folder, settings.workers, settings.worker_threads)
    return Service(
        settings=settings,
        place=place,
        store=store,
        files=files,
        engine=engine,
        desk=desk,
        dispatcher=dispatcher,
        wakeups=wakeups,
        admission=Admission(settings, store, files, desk),
        lock=lock,
        checkers=CapacityLimiter(_CHECKERS),
    )


def check_folder(settings: Settings) -> None:
    """Raise :class:`FolderInUseError` when another service uses the data folder, and OSError without access."""
    settings.data_dir.mkdir(parents=True, exist_ok=True)
    _lock(settings.data_dir.resolve()).close()


def _lock(folder: Path) -> TextIOWrapper:
    """Hold the folder for this process alone; the system lets go of it however the process ends."""
    file = (folder / "service.lock").open("w")
    try:
        import fcntl
    except ImportError:  # pragma: no cover - Windows
        return file
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise FolderInUseError(f"another service uses the data folder {folder}") from None
    return file
