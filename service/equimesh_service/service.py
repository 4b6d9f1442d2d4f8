"""A service: its parts, and how they are opened for the settings."""

from __future__ import annotations

import asyncio
import logging
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib import import_module
from importlib.util import find_spec
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from equimesh_coupling.errors import PARSING
from equimesh_service.admission.callers import Caller, Callers, Quotas
from equimesh_service.admission.intake import Body, Intake
from equimesh_service.admission.tasks import AdmittedSpec, PackedProblems
from equimesh_service.admission.unstored import UnstoredMeshes
from equimesh_service.dispatch.dispatcher import Dispatcher, Rules
from equimesh_service.dispatch.wakeups import END, Checked, CheckThreads, Wakeups
from equimesh_service.dispatch.worker_line import SideWorkers
from equimesh_service.engine.port import Engine, NamedFunction, PackedCall, PoolSettings, Preparation
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.errors import (
    ClusterMissingError,
    EngineError,
    FolderInUseError,
    MemoryLimitError,
    TimeLimitError,
    UnusableDatabaseError,
)
from equimesh_service.files.address import files_address
from equimesh_service.files.folder import make_folder
from equimesh_service.files.port import Files
from equimesh_service.problems.problem import Problem
from equimesh_service.settings import FILE_WORKERS, Settings
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.database import sqlite_file
from equimesh_service.store.rows import Artifact, MeshRow, SequenceRow
from equimesh_service.store.store import Store
from equimesh_service.telemetry import log_context, tracing
from equimesh_service.upkeep.metrics import Metrics, Snapshot
from equimesh_service.upkeep.readiness import OK, Readiness
from equimesh_service.upkeep.retention import Retention
from equimesh_service.wire.body import BodyRoom
from equimesh_service.worker.job import Export, Job, Storage
from equimesh_service.worker.rare_loops import LoopCount, RareLoops
from equimesh_service.worker.reach import Reach

if TYPE_CHECKING:
    from equimesh_service.admission.admit import Admission

# The functions of workers. Their modules need the solver, which this process imports when it checks a request itself.
_SOLVE = NamedFunction("equimesh_service.worker.solve:solve_mesh")
_EXPORT = NamedFunction("equimesh_service.worker.export:export")
_COUNT_LOOPS = NamedFunction("equimesh_service.worker.warmth:progress")
WARM_UP = NamedFunction("equimesh_service.worker.warmth:warm_up_once")
WARM_UP_BASICS = NamedFunction("equimesh_service.worker.warmth:warm_up_for_basics")
_CHECKS = ("admission.computation", "admission.steps", "assembly.bodies")
"""The modules with which this process checks requests."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Checks:
    """The checks of requests that no worker has, in threads of this process.

    They import the solver with the first of them: a service whose requests wait for workers never needs it.
    """

    settings: Settings
    store: Store
    files: Files
    side_workers: SideWorkers
    threads: CheckThreads
    lock: threading.Lock = field(default_factory=threading.Lock)

    @cached_property
    def admission(self) -> Admission:
        """The checks against the settings; to be used in a check thread."""
        # Modules that parse code when they are imported fail now and then next to a thread that does so, too.
        with self.lock, PARSING:
            for module in _CHECKS:
                import_module(f"equimesh_service.{module}")
            from equimesh_service.admission.admit import ServiceAdmission

            waiting = self.threads.while_waiting
            return ServiceAdmission(
                self.settings, self.store, self.files, side_workers=self.side_workers, while_waiting=waiting
            )

    async def admit(self, body: Body) -> AdmittedSpec:
        """The admitted spec of a request; raises its problems."""

        def admit() -> AdmittedSpec:
            admission = self.admission
            from equimesh_service.admission.computation import admit

            return admit(body.content_type, body.content, body.caller, admission)

        return await self.threads.run(admit)


@dataclass(kw_only=True)
class Service:
    """The parts of a service. ``engine`` solves; ``side_workers`` make files and pictures, and read samples."""

    settings: Settings
    storage: Storage
    store: Store
    files: BlobFiles
    engine: Engine
    side_workers: SideWorkers
    dispatcher: Dispatcher
    retention: Retention
    rare_loops: RareLoops
    wakeups: Wakeups
    checks: Checks
    callers: Callers
    quotas: Quotas
    intake: Intake
    unstored: UnstoredMeshes
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
            future = self.side_workers.submit(here.key_id, _EXPORT, task, time_limit=self.settings.time_limit)
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
        self.files.discard(sha256)

    def close(self) -> None:
        """Stop the work and close all parts; running meshes go back into the queue."""
        self.retention.stop()
        self.dispatcher.stop()
        self.engine.close()
        self.side_workers.close()
        self.rare_loops.stop()  # after the workers, for whose count of loops it may wait
        self.store.close()
        if self.lock is not None:
            self.lock.close()


# Modules that are loaded once, and shared by all workers. Those of SciPy would otherwise be loaded by each worker.
PRELOAD = (
    "equimesh_service.worker.no_collection",
    "scipy.fft",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.sparse.linalg",
    "scipy.spatial",
    "scipy.special",
    "equimesh_service.worker.solve",
    "equimesh_service.worker.export",
    "equimesh_service.admission.computation",
    "equimesh_service.assembly.samples",
)
# More of them, where workers warm up: the last one does everything once.
WARM_PRELOAD = (*PRELOAD, "equimesh_service.worker.warm_fork")


def open_service(settings: Settings, metrics: Metrics | None = None) -> Service:
    """Open all parts of a service, in a running event loop. Raises :class:`FolderInUseError`."""
    metrics = metrics or Metrics()
    folder = settings.data_dir.resolve()
    make_folder(folder)
    lock = _lock_folder(settings)
    storage = Storage(settings.database, files_address(settings))
    store = Store(storage.database_url)
    files = BlobFiles(store.database, storage.address.open())
    store.prepare()
    files.prepare(alone=lock is not None and not settings.files_url)
    engine, side_workers = _open_workers(settings, storage)
    loop_count = LoopCount(partial(side_workers.submit, "", _COUNT_LOOPS))
    rare_loops = RareLoops(lambda: engine.health().ready, loop_count.now)
    if settings.warm_up == "all" and settings.engine != "dask":
        rare_loops.start()
    problems = PackedProblems()
    wakeups, check_threads = Wakeups(store.meshes.find_unfinished, settings.poll), CheckThreads()
    dispatcher = Dispatcher(
        secrets.token_hex(8),
        store,
        engine,
        lambda claim, mesh_input: (
            _SOLVE,
            (
                Job(
                    storage,
                    claim,
                    settings.worker_threads,
                    mesh_input,
                    settings.scheduler,
                    problems.take(claim.mesh_id),
                    hands_over=settings.engine != "dask",
                ),
            ),
        ),
        _rules(settings),
        wakeups.announce,
        metrics,
        files.discard,
    )
    metrics.add_snapshots(lambda: _take_snapshot(store, engine))
    dispatcher.start(alone=lock is not None)
    retention = Retention(store, files, settings.retention_days)
    retention.start()
    where = f"the cluster at {settings.scheduler}" if settings.engine == "dask" else f"{settings.workers} workers"
    _log.info("data folder %s, %s, threads of one worker: %d", folder, where, settings.worker_threads)
    quotas = Quotas(settings, store.quotas)
    checks = Checks(settings, store, files, side_workers, check_threads)

    return Service(
        settings=settings,
        storage=storage,
        store=store,
        files=files,
        engine=engine,
        side_workers=side_workers,
        dispatcher=dispatcher,
        retention=retention,
        rare_loops=rare_loops,
        wakeups=wakeups,
        checks=checks,
        callers=Callers(store.keys),
        quotas=quotas,
        intake=Intake(settings, storage, store, dispatcher, wakeups, quotas, problems, metrics, checks.admit),
        unstored=UnstoredMeshes(settings, storage, engine, dispatcher.line),
        lock=lock,
        check_threads=check_threads,
        metrics=metrics,
        bodies=BodyRoom(folder, settings.max_body),
        readiness=Readiness(
            {
                "store": store.check,
                "files": files.check,
                "engine": lambda: _health(engine),
                "exports": lambda: _health(side_workers),
                "dispatcher": lambda: OK if dispatcher.is_alive() else "stopped",
            },
            warn=(store.clock_warning, lambda: _warning(engine)),
            warm_up=lambda: _warm_up(settings, engine, rare_loops, loop_count),
        ),
    )


def _open_workers(settings: Settings, storage: Storage) -> tuple[Engine, SideWorkers]:
    limit, prepare = settings.memory_limit, Preparation.of(settings)
    preload, warm_up = _start_of_workers(settings)
    engine: Engine
    if settings.engine == "dask":
        check_cluster(settings)
        from equimesh_service.engine.dask import DaskEngine

        engine = DaskEngine(settings.scheduler, pool_settings(settings, storage))
    else:
        engine = ProcessEngine(settings.workers, memory_limit=limit, preload=preload, prepare=prepare, warm_up=warm_up)
    return engine, SideWorkers(ProcessEngine(FILE_WORKERS, memory_limit=limit, preload=preload, prepare=prepare))


def _start_of_workers(settings: Settings) -> tuple[tuple[str, ...], Callable[[], None] | None]:
    """The modules that workers share, and the warm-up of a worker that solves, as the settings say."""
    if settings.warm_up == "none":
        return PRELOAD, None
    # Nobody compiles the rest for the workers of a cluster.
    return WARM_PRELOAD, WARM_UP if settings.engine == "dask" else WARM_UP_BASICS


def pool_settings(settings: Settings, storage: Storage) -> PoolSettings:
    """The settings of the pools that the workers of a cluster open for this service."""
    preload, warm_up = _start_of_workers(settings)
    return PoolSettings(
        memory_limit=settings.memory_limit,
        preload=preload,
        warm_up=None if warm_up is None else PackedCall.of(warm_up),
        prepare=PackedCall.of(Preparation.of(settings)),
        check=PackedCall.of(Reach.of(storage).describe_faults),
    )


def check_cluster(settings: Settings) -> None:
    """Raise :class:`ClusterMissingError` when the settings need a cluster, and Dask is not installed."""
    if settings.engine == "dask" and find_spec("distributed") is None:
        raise ClusterMissingError("the engine dask needs more packages: pip install 'equimesh[dask]'")


def _rules(settings: Settings) -> Rules:
    return Rules(
        time_limit=settings.time_limit,
        memory_limit=settings.memory_limit,
        max_attempts=settings.max_attempts,
        lease=settings.lease,
        poll=settings.poll,
    )


def _health(engine: Engine | SideWorkers) -> str:
    health = engine.health()
    return OK if health.ready else health.detail


def _warm_up(
    settings: Settings, engine: Engine, rare_loops: RareLoops, loop_count: LoopCount
) -> Mapping[str, int] | None:
    """How far the loops are, until the last process that compiles them in advance has ended."""
    is_over = settings.engine == "dask" or (engine.health().ready and not rare_loops.are_compiling)
    return None if is_over else loop_count.latest()


def _warning(engine: Engine) -> str | None:
    """The warnings of an engine that works: workers of a cluster that it does not use."""
    health = engine.health()
    return health.detail if health.ready and health.detail else None


def _take_snapshot(store: Store, engine: Engine) -> Snapshot:
    try:
        counts = store.queue.count()
    except SQLAlchemyError:
        counts = None  # the scrape reports that the store is down
    return Snapshot(workers={"solve": engine.health().workers, "files": FILE_WORKERS}, counts=counts)


def check_files(settings: Settings) -> None:
    """Raise OSError when the storage of files cannot be used."""
    files_address(settings).open().prepare(alone=False)


def check_folder(settings: Settings) -> None:
    """Raise :class:`FolderInUseError` when another service uses the data folder, and OSError without access."""
    make_folder(settings.data_dir)
    lock = _lock_folder(settings)
    if lock is not None:
        lock.close()


def check_database(settings: Settings) -> None:
    """Bring the database up to this release; raises :class:`UnusableDatabaseError` when that cannot be done."""
    store = Store(settings.database)
    try:
        store.prepare()
    except DBAPIError as error:
        file = sqlite_file(settings.database)
        if file is not None:
            raise UnusableDatabaseError(f"the database {file} cannot be used: {error.orig}") from None
        # The message of the driver may hold the address.
        raise UnusableDatabaseError(
            f"the database does not answer ({type(error.orig).__name__}): check EQUIMESH_DATABASE_URL, and that its "
            "server runs"
        ) from None
    finally:
        store.close()


def _lock_folder(settings: Settings) -> TextIOWrapper | None:
    """Lock the folder of an SQLite database for this process; the system releases it however the process ends.

    None for a database server, which any number of services share.
    """
    file_path = sqlite_file(settings.database)
    if file_path is None:
        return None
    folder = file_path.resolve().parent
    file = (folder / "service.lock").open("w")
    try:
        import fcntl
    except ImportError:  # pragma: no cover - Windows
        return file
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        raise FolderInUseError(
            f"another service uses the data folder {folder}: stop it, or choose another folder with --data-dir"
        ) from None
    return file
