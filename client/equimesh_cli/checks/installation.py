"""Checks of this machine: packages, files that are compiled, memory, threads, storage."""

from __future__ import annotations

import os
import platform
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from packaging.requirements import Requirement

    from equimesh_service.settings import Settings
    from equimesh_service.store.database import InspectionStore


# The result of one check of an installation.


class Level(StrEnum):
    """How bad a finding is: the service works, works with a fault, or does not work."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A finding: its level, a ``message`` for the user, and the remedy."""

    level: Level
    message: str
    remedy: str = ""


def ok(message: str) -> Finding:
    """A finding without anything to do."""
    return Finding(level=Level.OK, message=message)


def warning(message: str, remedy: str) -> Finding:
    """A finding that should be mended, although the service works."""
    return Finding(level=Level.WARNING, message=message, remedy=remedy)


def failed(message: str, remedy: str = "") -> Finding:
    """A finding with which the service does not work; ``message`` may hold the remedy itself."""
    return Finding(level=Level.FAILED, message=message, remedy=remedy)


# The largest q_eq of a single domain in Table 1 of Haynes and Howse, as it is printed.
TABLE_1 = "1.1979"
# Measured: 68 s of processor time for all loops.
COMPILING = "about a minute of processor time"
REMEDY = "set EQUIMESH_CACHE_DIR to a folder that belongs to the user of the service, and that nobody else can write"


def variables(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether every EQUIMESH_ variable is a setting."""
    from equimesh_service.settings import describe_unknown, find_unknown

    foreign = find_unknown(os.environ)
    if foreign:
        message = "; ".join(describe_unknown(name, nearest) for name, nearest in foreign.items())
        return warning(message, "correct or unset misspelled variables; `equimesh config` shows the settings")
    return ok("every EQUIMESH_ variable is a setting")


def python(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether the package supports this Python."""
    from importlib import metadata

    from packaging.specifiers import SpecifierSet

    wanted = metadata.metadata("equimesh")["Requires-Python"]
    here = platform.python_version()
    if not SpecifierSet(wanted).contains(here, prereleases=True):
        return failed(f"this is Python {here}; equimesh needs {wanted}", "install equimesh with such a Python")
    return ok(f"{here} (needs {wanted})")


def packages(settings: Settings) -> Finding:
    """Whether all packages that the settings need are installed, in the required versions."""
    from importlib import metadata

    extras = ["service"]
    if settings.database.startswith("postgres"):
        extras.append("postgres")
    if settings.files_url.startswith("s3:"):
        extras.append("s3")
    if settings.engine == "dask":
        extras.append("dask")
    if settings.trace_endpoint:
        extras.append("tracing")
    wanted = {str(requirement): requirement for extra in extras for requirement in _requirements(extra)}
    wrong = sorted(filter(None, map(_fault, wanted.values())))
    if wrong:
        return failed("; ".join(wrong), f"pip install 'equimesh[{','.join(extras)}]'")
    version = metadata.version("equimesh")
    return ok(f"equimesh {version} with {', '.join(extras)}: {len(wanted)} packages in the required versions")


def kernels(settings: Settings) -> Finding:  # noqa: ARG001
    """Where the machine code of the loops comes from, and why no archive is used, or no folder."""
    import equimesh.warm_up  # noqa: F401  # has all loops
    from equimesh.numerics.compiled import count_kept
    from equimesh.numerics.machine_code import find_archive, find_folder

    kept, archive, folder = count_kept(), find_archive(), find_folder()
    counts = f"{sum(kept)} numerical loops: {kept.archive} from the archive, {kept.folder} from the folder of this user"
    found = f"{counts}, {kept.nowhere} to be compiled"
    if isinstance(archive, str):
        found += f"; no archive is used: {archive}"
    elif kept.archive < sum(kept):
        found += f"; the archive {archive.path} is of other sources, or of fewer loops"
    if isinstance(folder, str):
        lost = f"{folder}; every start compiles what is in no archive, {COMPILING} for all loops"
        return warning(f"{found}; {lost}", REMEDY) if kept.nowhere else ok(f"{found}; no folder is needed")
    if kept.nowhere and not os.access(folder.path, os.W_OK):
        return warning(f"{found}; {folder.path} cannot be written: every start compiles them, {COMPILING}", REMEDY)
    if kept.nowhere:
        found += f"; the first start compiles them, {COMPILING} for all loops, and keeps them in {folder.path}"
    return ok(found)


def solve(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether the mesh of the paper has the printed quality."""
    import equimesh as em
    from equimesh_cli.report import announce_compiling

    u = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
    grid = em.Grid(n_xi=12, n_eta=12)
    problem = em.Problem(monitor=em.ArcLength(u=u, a=0.7, b=0.05), grid=grid, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    began = time.perf_counter()
    with announce_compiling():
        solution = em.solve(problem, initial=em.Initial.UNIFORM)
    took = time.perf_counter() - began
    found = f"{solution.quality.q_eq.max:.4f}"
    if found != TABLE_1:
        return failed(
            f"the mesh of Table 1 has the quality {found}; the paper prints {TABLE_1}",
            "install the versions of constraints.txt, and empty the folder of compiled loops",
        )
    return ok(f"the mesh of Table 1 has the printed quality, q_eq {found}; solved in {took:.2g} s")


def _requirements(extra: str) -> Iterator[Requirement]:
    """The requirements of an extra and of the extras that it names."""
    from importlib import metadata

    from packaging.requirements import Requirement

    for text in metadata.requires("equimesh") or []:
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        if requirement.name == "equimesh":
            for further in sorted(requirement.extras):
                yield from _requirements(further)
        else:
            requirement.marker = None
            yield requirement


def _fault(requirement: Requirement) -> str | None:
    from importlib import metadata

    try:
        here = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        return f"{requirement.name} is not installed"
    if not requirement.specifier.contains(here, prereleases=True):
        return f"{requirement.name} is {here}; {requirement.specifier} is needed"
    return None


# Checks of the machine: processors and memory, within the limits of the system or a container.

MIB = 1024 * 1024
CGROUPS, OWN_GROUP = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
MIN_WORKER_MIB = 128
"""Memory with which a worker can solve small meshes."""
# Version 1 writes "no limit" as a number near the largest one.
_NO_LIMIT = 1 << 60


def processors(settings: Settings) -> Finding | None:
    """Whether there is a processor for every worker and for each of its threads; None where a cluster solves."""
    if not settings.own_workers:
        return None
    from equimesh.numerics.threads import available_cores

    here, allowed = available_cores(), allowed_processors()
    count = float(here) if allowed is None else min(float(here), allowed)
    message = f"{settings.workers} workers with {settings.worker_threads} threads each, on {count:g} processors"
    if settings.workers > max(1.0, count):
        return warning(message, f"a solve keeps one processor busy: set EQUIMESH_WORKERS={max(1, int(count))}")
    if settings.workers * settings.worker_threads > max(1.0, count):
        return warning(message, "set EQUIMESH_THREADS=0, which divides the processors, or fewer EQUIMESH_WORKERS")
    return ok(message)


def memory(settings: Settings) -> Finding:
    """Whether there is memory for the limits of all workers."""
    from equimesh_service.settings import FILE_WORKERS, SERVICE_MIB

    present = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    allowed = allowed_memory()
    where = "machine" if allowed is None or allowed >= present else "container"
    room = (present if allowed is None else min(present, allowed)) // MIB
    processes = settings.own_workers + FILE_WORKERS
    most, least = settings.most_memory, processes * MIN_WORKER_MIB + SERVICE_MIB
    message = (
        f"{settings.own_workers} workers that solve and {FILE_WORKERS} for files may take {settings.memory_limit} MiB "
        f"each, the service {SERVICE_MIB} MiB: {most} MiB in all; this {where} has {room} MiB"
    )
    if room < least:
        return failed(message, f"give it at least {least} MiB, or set fewer EQUIMESH_WORKERS")
    if room < most:
        fits = max(16, (room - SERVICE_MIB) // processes)
        remedy = f"lower EQUIMESH_MEMORY_LIMIT to {fits}, or EQUIMESH_WORKERS; otherwise the system may kill workers"
        return warning(message, remedy)
    return ok(message)


def allowed_memory() -> int | None:
    """Bytes that the control groups of this process allow it; None without a limit."""
    found = [
        int(text)
        for text in _limits("memory", "memory.max", "memory.limit_in_bytes")
        if text.isdigit() and int(text) < _NO_LIMIT
    ]
    return min(found, default=None)


def allowed_processors() -> float | None:
    """Processors that the control groups of this process allow it; None without a limit."""
    found = []
    for text in _limits("cpu", "cpu.max", "cpu.cfs_quota_us"):
        quota, _, period = text.partition(" ")
        if quota.isdigit():
            found.append(int(quota) / int(period or 100_000))
    return min(found, default=None)


def _limits(controller: str, file: str, file_v1: str) -> Iterator[str]:
    """The texts of a file in the control group of this process and in all above it, in versions 1 and 2."""
    try:
        lines = OWN_GROUP.read_text().splitlines()
    except OSError:
        return  # not Linux
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, name = CGROUPS, file
        elif controller in controllers.split(","):
            root, name = CGROUPS / controllers, file_v1
            if not root.is_dir():
                root = CGROUPS / controller
        else:
            continue
        group = root / path.lstrip("/")
        # Inside a container the path may be that of the host, and its groups be mounted at the root.
        while group != root.parent:
            if (group / name).is_file():
                yield (group / name).read_text().strip()
            group = group.parent


# Checks of the data of a service: folder, database, clock, files. They leave nothing behind.

MOUNTS = Path("/proc/self/mountinfo")
# File systems whose locks and shared memory SQLite in WAL mode cannot rely on.
NETWORK = {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "lustre", "gfs2", "beegfs", "vboxsf"}
GIB = 1024**3
MIN_FREE_BYTES = 0.1 * GIB
"""With less free storage the check fails."""
LOW_FREE_BYTES = 1.0 * GIB
"""With less free storage the check warns."""


def folder(settings: Settings) -> Finding:
    """Whether the data folder can be written, or created, and hides the database from other users."""
    from equimesh_service.store.database import sqlite_file

    place = settings.data_dir.resolve()
    try:
        there = _try_writing(place)
    except OSError as error:
        message = f"the data folder {place} cannot be written: {error.strerror}"
        return failed(message, "let the user of the service write it, or choose another with EQUIMESH_DATA_DIR")
    kind = file_system(there)
    if kind.removeprefix("fuse.").startswith(tuple(NETWORK | {"sshfs", "s3fs", "glusterfs", "rclone"})):
        message = f"the data folder {place} is on a network file system ({kind})"
        if sqlite_file(settings.database) is not None:
            return failed(message, "SQLite needs a local disk: choose one with EQUIMESH_DATA_DIR, or take PostgreSQL")
        return ok(f"{message}; the database is elsewhere")
    file = sqlite_file(settings.database)
    if file is not None and file.exists() and _can_be_read_by_others(file):
        message = f"other users of this machine can read the database {file}"
        return warning(message, f"close its folder to them: chmod -R go= {file.parent}")
    return ok(f"{place} can be written ({kind})" if there == place else f"{place} can be created in {there} ({kind})")


def disk(settings: Settings) -> Finding:
    """Whether there is free storage for the data folder."""
    there = _nearest_existing(settings.data_dir.resolve())
    free = shutil.disk_usage(there).free
    message = f"{free / GIB:.1f} GiB are free in {there}"
    remedy = "free storage, or lower EQUIMESH_RETENTION_DAYS; a service whose storage is full answers 507"
    if free < MIN_FREE_BYTES:
        return failed(message, remedy)
    return warning(message, remedy) if free < LOW_FREE_BYTES else ok(message)


def database(settings: Settings) -> Finding:
    """Whether the database answers and is undamaged, and its revision."""
    from equimesh_service.store.database import LATEST, current, sqlite_file

    file = sqlite_file(settings.database)
    if file is not None and not file.exists():
        return ok(f"the first start creates {file}")
    kind = "PostgreSQL" if file is None else f"SQLite, {file}"
    revision = current(settings.database)
    if revision is None:
        return ok(f"{kind}: it answers and is empty; the first start creates its tables")
    if revision != LATEST:
        message = f"{kind}: it has revision {revision}; the next start upgrades it to {LATEST}"
        return warning(message, "back it up first, see docs/how-to/upgrade.md")
    with open_inspection(settings) as inspection:
        fault = inspection.fault()
    if fault is not None:
        return failed(
            f"{kind}: the database is damaged ({fault})", "restore the last backup, see docs/how-to/back-up.md"
        )
    return ok(f"{kind}: revision {revision}, the one of this release")


def clock(settings: Settings) -> Finding | None:
    """Whether this machine's clock agrees with the database; None where there is nothing to compare with."""
    if not has_tables(settings):
        return None
    from equimesh_service.store.clock import describe_skew

    with open_inspection(settings) as inspection:
        ahead = inspection.clock_skew()
    message = describe_skew(ahead)
    if message is not None:
        return warning(message, "set the clocks (NTP): logs, traces and requests to S3 have the time of this machine")
    return ok(f"the clocks agree to {abs(ahead):.1f} s")


def files(settings: Settings) -> Finding:
    """Whether the storage of files can be written and read."""
    from equimesh_service.files.address import files_address
    from equimesh_service.files.folder import FolderFiles

    address = files_address(settings)
    storage = address.open()
    if isinstance(storage, FolderFiles):
        try:
            there = _try_writing(storage.folder)
        except OSError as error:
            message = f"the folder {storage.folder} cannot be written: {error.strerror}"
            return failed(message, "let the user of the service write it, or choose another with EQUIMESH_FILES_URL")
        return ok(f"{storage.folder}" if there == storage.folder else f"{storage.folder} can be created")
    with tempfile.TemporaryDirectory() as here:  # so that the check leaves no folder behind
        replace(address, folder=Path(here) / "files").open().prepare(alone=False)
    return ok("an object can be written to the bucket, read and deleted")


def stored_files(settings: Settings) -> Finding | None:
    """Whether every file that the database names exists; None for a database without tables."""
    from equimesh_service.files.address import files_address
    from equimesh_service.files.folder import FolderFiles

    if not has_tables(settings):
        return None
    storage = files_address(settings).open()
    none = isinstance(storage, FolderFiles) and not storage.folder.is_dir()
    present = {} if none else {file.sha256: file.size for file in storage.listing()}
    with open_inspection(settings) as inspection:
        named, rows = inspection.named_files(), inspection.file_rows()
    present |= rows
    lost = sorted(name for name in named if name not in present)
    damaged = sorted(name for name, size in named.items() if present.get(name, size) != size)
    if lost or damaged:
        message = f"of {len(named)} files in the database {len(lost)} are missing and {len(damaged)} are damaged"
        return failed(
            f"{message}, first {(lost or damaged)[0]}", "copy them from the last backup, see docs/how-to/back-up.md"
        )
    return ok(f"all {len(named)} files in the database exist")


def file_system(path: Path) -> str:
    """The kind of the file system of a path; "unknown" where the system does not report it."""
    try:
        lines = MOUNTS.read_text().splitlines()
    except OSError:
        return "unknown"
    best, kind = "", "unknown"
    for line in lines:
        mount, _, source = line.partition(" - ")
        point = mount.split()[4].encode().decode("unicode_escape")  # blanks are written \040
        if path.is_relative_to(point) and len(point) >= len(best):
            best, kind = point, source.split()[0]
    return kind


def has_tables(settings: Settings) -> bool:
    """Whether the database exists, with the tables of this release."""
    from equimesh_service.store.database import LATEST, current, sqlite_file

    file = sqlite_file(settings.database)
    return (file is None or file.exists()) and current(settings.database) == LATEST


@contextmanager
def open_inspection(settings: Settings) -> Iterator[InspectionStore]:
    """The database, open for reading."""
    from equimesh_service.store.database import Database, InspectionStore

    database = Database(settings.database)
    try:
        yield InspectionStore(database)
    finally:
        database.close()


def _can_be_read_by_others(file: Path) -> bool:
    """Whether any user may read the file: it and its folder let them."""
    return bool(file.stat().st_mode & stat.S_IROTH and file.parent.stat().st_mode & stat.S_IXOTH)


def _nearest_existing(path: Path) -> Path:
    """The path, or the nearest folder above it that exists."""
    while not path.exists():
        path = path.parent
    return path


def _try_writing(path: Path) -> Path:
    """The folder in which a temporary file was written: the path, or the nearest above it. Raises OSError."""
    there = _nearest_existing(path)
    tempfile.TemporaryFile(dir=there).close()
    return there
