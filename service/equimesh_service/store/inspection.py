"""SQL for operators: whether a database is sound, its clock right, and which files it names."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from sqlalchemy import func, select

from equimesh_service.errors import UnusableDatabaseError
from equimesh_service.store.clock import MAX_SKEW_SECONDS, skew
from equimesh_service.store.database import Database, sqlite_file
from equimesh_service.store.schema import artifacts, keys, meshes, samples


class InspectionStore:
    """Inspects a database of this release, without changes."""

    def __init__(self, database: Database, clock: Callable[[], float] | None = None) -> None:
        self._read = database.read
        self._clock = clock or database.clock

    def fault(self) -> str | None:
        """The fault that SQLite finds in its file, None for a sound one; PostgreSQL checks its files itself."""
        with self._read() as connection:
            if connection.dialect.name != "sqlite":
                return None
            report = str(connection.exec_driver_sql("PRAGMA quick_check(1)").scalar())
        return None if report == "ok" else report.splitlines()[-1]

    def clock_skew(self) -> float:
        """The seconds that this machine's clock is ahead of the database's; negative when it is behind.

        SQLite has no clock: a mesh from the future shows that this machine's clock is behind.
        """
        with self._read() as connection:
            newest = connection.execute(select(func.max(meshes.c.created_at))).scalar() or 0.0
        ahead = skew(self._clock)
        return ahead if abs(ahead) > MAX_SKEW_SECONDS else min(ahead, self._clock() - newest)

    def named_files(self) -> dict[str, int]:
        """The size of every file that a mesh or samples name, by its SHA-256."""
        with self._read() as connection:
            rows = [
                *connection.execute(select(artifacts.c.sha256, artifacts.c.size)),
                *connection.execute(select(samples.c.sha256, samples.c.size)),
            ]
        return {row.sha256: row.size for row in rows}

    def has_keys(self) -> bool:
        """Whether an API key was ever created."""
        with self._read() as connection:
            return connection.execute(select(keys.c.id).limit(1)).first() is not None


def back_up(url: str, target: Path) -> int:
    """Copy a snapshot of an SQLite database, which may be in use; returns the bytes of the copy.

    Raises :class:`UnusableDatabaseError` for PostgreSQL, which has its own programs, :class:`FileExistsError` when the
    target exists, and :class:`FileNotFoundError` when the database does not.
    """
    source = sqlite_file(url)
    if source is None:
        raise UnusableDatabaseError("this copies SQLite databases; for PostgreSQL use pg_dump --format=custom")
    source.stat()
    target.touch(mode=0o600, exist_ok=False)  # it holds hashes of keys, and input of users
    address = f"{source.resolve().as_uri()}?mode=ro"
    with closing(sqlite3.connect(address, uri=True)) as live, closing(sqlite3.connect(target)) as copy:
        live.backup(copy)  # in one step: a snapshot, during which others may write
        copy.execute("PRAGMA journal_mode=DELETE")  # one file, without a log next to it
    return target.stat().st_size
