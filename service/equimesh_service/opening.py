"""The opening of a service: its parts in order, and the checks before them."""

import logging
import secrets
from collections.abc import Callable
from importlib.util import find_spec
from io import TextIOWrapper

from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from equimesh_service.admission.admit import Admission
from equimesh_service.admission.callers import Callers
from equimesh_service.admission.intake import Intake
from equimesh_service.admission.preview_admission import PreviewAdmission
from equimesh_service.admission.previews import Previews
from equimesh_service.admission.quotas import Quotas
from equimesh_service.assembly.problem import PackedProblems
from equimesh_service.dispatch.check_threads import CheckThreads
from equimesh_service.dispatch.dispatcher import Dispatcher, Rules
from equimesh_service.dispatch.side_workers import SideWorkers
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.engine.packed_call import PackedCall
from equimesh_service.engine.pebble import PebbleEngine
from equimesh_service.engine.pool_settings import PoolSettings
from equimesh_service.engine.port import Engine
from equimesh_service.engine.preparation import Preparation
from equimesh_service.errors import ClusterMissingError, FolderInUseError, UnusableDatabaseError
from equimesh_service.files.address import files_address
from equimesh_service.files.privacy import make_folder
from equimesh_service.service import Service
from equimesh_service.settings import FILE_WORKERS, Settings
from equimesh_service.store.database import sqlite_file
from equimesh_service.store.store import Store
from equimesh_service.upkeep.metrics import Metrics, Snapshot
from equimesh_service.upkeep.readiness import OK, Readiness
from equimesh_service.upkeep.retention import Retention
from equimesh_service.wire.body import BodyRoom
from equimesh_service.worker import solve, warmth
from equimesh_service.worker.job import Job, Storage
from equimesh_service.worker.reach import Reach

_log = logging.getLogger(__name__)
# Modules that are loaded once, and shared by all workers.
PRELOAD = (
    "equimesh_service.worker.solve",
    "equimesh_service.worker.export",
    "equimesh_service.worker.preview",
    "equimesh_service.assembly.samples",
)
# More of them, where workers warm up: the last one does everything once.
WARM_PRELOAD = (
    *PRELOAD,
    "equimesh.plot.meshes",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
    "equimesh_service.worker.warm_fork",
)


def open_service(settings: Settings, metrics: Metrics | None = None) -> Service:
    """Open all parts of a service, in a running event loop. Raises :class:`FolderInUseError`."""
    metrics = metrics or Metrics()
    folder = settings.data_dir.resolve()
    make_folder(folder)
    lock = _lock_folder(settings)
    storage = Storage(settings.database, files_address(settings))
    store, files = Store(storage.database_url), storage.files()
    store.prepare()
    files.prepare(alone=lock is not None and not settings.files_url)
    engine, side_workers = _open_workers(settings, storage)
    problems = PackedProblems()
    wakeups, check_threads = Wakeups(store.meshes.find_unfinished, settings.poll), CheckThreads()
    dispatcher = Dispatcher(
        secrets.token_hex(8),
        store,
        engine,
        lambda claim, mesh_input: (
            solve.solve_mesh,
            (
                Job(
                    storage,
                    claim,
                    settings.worker_threads,
                    mesh_input,
                    settings.scheduler,
                    problems.take(claim.mesh_id),
                ),
            ),
        ),
        _rules(settings),
        wakeups.announce,
        metrics,
    )
    metrics.add_snapshots(lambda: _take_snapshot(store, engine))
    dispatcher.start(alone=lock is not None)
    retention = Retention(store, files, settings.retention_days)
    retention.start()
    where = f"the cluster at {settings.scheduler}" if settings.engine == "dask" else f"{settings.workers} workers"
    _log.info("data folder %s, %s, threads of one worker: %d", folder, where, settings.worker_threads)
    quotas = Quotas(settings, store.quotas)
    admission = Admission(settings, store, files, side_workers, check_threads.while_waiting)
    return Service(
        settings=settings,
        storage=storage,
        store=store,
        files=files,
        engine=engine,
        side_workers=side_workers,
        dispatcher=dispatcher,
        retention=retention,
        wakeups=wakeups,
        admission=admission,
        callers=Callers(store.keys),
        quotas=quotas,
        intake=Intake(settings, store, admission, dispatcher, wakeups, quotas, problems),
        previews=Previews(settings, storage, PreviewAdmission.of(admission), check_threads, engine, dispatcher.line),
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
            warm_up=lambda: None if settings.engine == "dask" or engine.health().ready else warmth.progress(),
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
        engine = PebbleEngine(settings.workers, memory_limit=limit, preload=preload, prepare=prepare, warm_up=warm_up)
    return engine, SideWorkers(PebbleEngine(FILE_WORKERS, memory_limit=limit, preload=preload, prepare=prepare))


def _start_of_workers(settings: Settings) -> tuple[tuple[str, ...], Callable[[], None] | None]:
    """The modules that workers share, and the warm-up of a worker that solves, as the settings say."""
    return (WARM_PRELOAD, warmth.warm_up_once) if settings.warm_up == "all" else (PRELOAD, None)


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
