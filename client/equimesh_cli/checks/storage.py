"""Checks of the data of a service: folder, database, clock, files. They leave nothing behind."""

from __future__ import annotations

import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from equimesh_cli.checks.installation import Finding, failed, ok, warning

if TYPE_CHECKING:
    from equimesh_service.settings import Settings
    from equimesh_service.store.inspection import InspectionStore

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
    from equimesh_service.store.database import sqlite_file
    from equimesh_service.store.migration import LATEST, current

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
    with open_inspection(settings) as inspection:
        named = inspection.named_files()
    storage = files_address(settings).open()
    none = isinstance(storage, FolderFiles) and not storage.folder.is_dir()
    present = {} if none else {file.sha256: file.size for file in storage.listing()}
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
    from equimesh_service.store.database import sqlite_file
    from equimesh_service.store.migration import LATEST, current

    file = sqlite_file(settings.database)
    return (file is None or file.exists()) and current(settings.database) == LATEST


@contextmanager
def open_inspection(settings: Settings) -> Iterator[InspectionStore]:
    """The database, open for reading."""
    from equimesh_service.store.database import Database
    from equimesh_service.store.inspection import InspectionStore

    database = Database(settings.database, durable=False)
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
