"""A database behind a URL: its connections, transactions, revision, and whether it is sound.

SQLite is used in WAL mode, by many processes. PostgreSQL is used with "read committed" transactions: a writer locks the
rows that must not change meanwhile, or takes a lock by name.
"""

from __future__ import annotations

import json
import logging
import os
import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from threading import RLock
from typing import Any

from sqlalchemy import (
    Column,
    Connection,
    MetaData,
    RootTransaction,
    String,
    Table,
    create_engine,
    event,
    func,
    insert,
    inspect,
    select,
    text,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL, ExceptionContext, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError

from equimesh_service.errors import NewerDatabaseError, UnusableDatabaseError
from equimesh_service.store.clock import MAX_SKEW_SECONDS, ServerClock, skew
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.schema import artifacts, blobs, keys, meshes, metadata, samples

# Of a connection to SQLite: whether its file could not be written to when it was opened.
_READ_ONLY = "read only"
# How long a transaction of SQLite waits for another one.
_BUSY_SECONDS = 30.0
_ADDRESS_FORMS = "addresses are postgresql+psycopg://user:password@host/name and sqlite:////path/of/a/file"
_POSTGRES = ("postgres", "postgresql", "postgresql+psycopg")
# A server that does not answer within this time counts as down.
_CONNECT_SECONDS = 5
# A replica that freezes inside a transaction, or loses its host, must not block the other replicas.
_IDLE_OPTION = "-c idle_in_transaction_session_timeout=60s"
# A server that loses its host is given up after about 20 s, not after hours as by default.
_KEEPALIVE = {"keepalives_idle": 10, "keepalives_interval": 5, "keepalives_count": 2, "tcp_user_timeout": 20_000}


class Database:
    """Reading and writing transactions, for all threads of a process.

    ``clock`` returns the database's time in seconds since 1970; SQLite has the time of this machine. Raises
    :class:`UnusableDatabaseError`.
    """

    def __init__(self, url: str) -> None:
        address = _address(url)
        self._outer = threading.local()  # in each thread, the writing transaction that it is in
        # SQLite has one writer at a time; others sleep for longer and longer. The threads of this process wait here
        # instead, where they wake at once.
        self._turns: AbstractContextManager[object] = nullcontext()
        self._server_clock = None if address.get_backend_name() == "sqlite" else ServerClock(self.read)
        self.clock: Callable[[], float] = self._server_clock or time.time
        if address.get_backend_name() == "sqlite":
            self._turns = RLock()
            arguments: dict[str, Any] = {"timeout": _BUSY_SECONDS, "check_same_thread": False}
            self._engine = create_engine(
                address,
                connect_args=arguments,
                json_serializer=to_json,
                pool_size=8,
                max_overflow=64,
                pool_use_lifo=True,  # pages that another connection has written are read again: mostly one works
            )
            event.listen(self._engine, "connect", _prepare_sqlite)
            event.listen(self._engine, "begin", _begin_sqlite)
            event.listen(self._engine, "checkin", _drop_read_only)
            event.listen(self._engine, "handle_error", _drop_all_read_only)
        else:
            if find_spec("psycopg") is None:
                raise UnusableDatabaseError(
                    "PostgreSQL needs psycopg; install it with: pip install 'equimesh[postgres]'"
                )
            more = str(address.query.get("options", ""))
            self._engine = create_engine(
                address,
                connect_args={"connect_timeout": _CONNECT_SECONDS, "options": f"{_IDLE_OPTION} {more}", **_KEEPALIVE},
                json_serializer=to_json,
                pool_size=8,
                max_overflow=8,
                pool_pre_ping=True,  # replaces connections from before a restart of the server
            )
            # Before the driver of SQLAlchemy asks for anything, which fails with other encodings.
            event.listen(self._engine, "connect", _refuse_other_encodings, insert=True)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A transaction that only reads; inside a writing one of this thread it reads what that has written."""
        outer = self._writing
        if outer is not None:
            yield outer
            return
        with self._engine.connect() as connection:
            if self._server_clock is not None:
                self._server_clock.follow(connection)
            yield connection

    @contextmanager
    def write(self, *, durable: bool = True) -> Iterator[Connection]:
        """A transaction that is committed at the end, or undone by an exception.

        A ``durable`` commit is on disk when it returns. After another one, a crash of the machine may undo it; a crash
        of the process does not. It reaches the disk with the next durable commit at the latest, since both are written
        to the same log.

        Inside another writing transaction of this thread it is a part of that (a savepoint): an exception undoes the
        part alone, and what is left is committed with the whole.
        """
        outer = self._writing
        if outer is not None:
            with outer.begin_nested():
                yield outer
            return
        calls = list[Callable[[], None]]()
        with self._turns:
            transaction = self._begin(durable)
            with transaction.connection as connection, transaction:
                if not durable and connection.dialect.name == "postgresql":
                    connection.execute(text("SET LOCAL synchronous_commit TO off"))
                if self._server_clock is not None:
                    self._server_clock.follow(connection)
                self._outer.connection, self._outer.calls = connection, calls
                try:
                    yield connection
                finally:
                    self._outer.connection = None
        for call in calls:
            _follow(call)

    def _begin(self, durable: bool) -> RootTransaction:
        """Begin a writing transaction.

        As long as one connection of a process is open that was opened while the disk took no writes, SQLite refuses
        writes by all others, which share its index of the log. It is closed when its reader ends.
        """
        latest = time.monotonic() + _BUSY_SECONDS
        while True:
            connection = self._engine.connect().execution_options(writes=True, synced=durable)
            try:
                return connection.begin()
            except BaseException as error:
                connection.close()
                if not (_is_read_only(error) and self._takes_writes()) or time.monotonic() > latest:
                    raise
            time.sleep(0.01)

    def _takes_writes(self) -> bool:
        return os.access(self._engine.url.database or "", os.W_OK)

    @contextmanager
    def join(self) -> Iterator[Connection]:
        """The writing transaction that this thread is in, or one of its own; an exception undoes all of it.

        A savepoint, as by :meth:`write`, takes as long as four statements.
        """
        outer = self._writing
        if outer is not None:
            yield outer
            return
        with self.write() as connection:
            yield connection

    def when_committed(self, call: Callable[[], None]) -> None:
        """Call a function when the writing transaction of this thread is committed; now, where there is none.

        It may fail, since what it follows cannot be undone any more: then it is logged.
        """
        if self._writing is None:
            _follow(call)
        else:
            self._outer.calls.append(call)

    @property
    def _writing(self) -> Connection | None:
        return getattr(self._outer, "connection", None)

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def _follow(call: Callable[[], None]) -> None:
    try:
        call()
    except Exception as error:
        _log.warning("what follows a commit has failed, and is done later: %s", type(error).__name__)


def lock(connection: Connection, names: Iterable[str]) -> None:
    """Lock ``names`` until the end of this writing transaction; other transactions wait for them."""
    if connection.dialect.name == "postgresql":  # SQLite has one writer at a time anyway
        for name in sorted(set(names)):  # in order, against deadlocks
            number = int.from_bytes(sha256(name.encode()).digest()[:8], "big", signed=True)
            connection.execute(select(func.pg_advisory_xact_lock(number)))


def insert_new(connection: Connection, table: Table, row: Mapping[str, Any]) -> bool:
    """Insert a row; False when a row with its key exists, which is not changed."""
    return _insert_new(table, connection.dialect.name).execute(connection, row).rowcount == 1


@cache
def _insert_new(table: Table, dialect: str) -> Prepared:
    make = postgresql.insert if dialect == "postgresql" else sqlite.insert
    return Prepared(make(table).inline().on_conflict_do_nothing())


def sqlite_file(url: str) -> Path | None:
    """The file of an SQLite database; None for PostgreSQL. Raises :class:`UnusableDatabaseError`."""
    address = _address(url)
    return Path(address.database or "") if address.get_backend_name() == "sqlite" else None


def to_json(value: Any) -> str:
    """Compact JSON; raises ValueError for NaN and infinities."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def _address(url: str) -> URL:
    try:
        address = make_url(url)
    except (ArgumentError, ValueError):
        raise UnusableDatabaseError(f"this is not the address of a database; {_ADDRESS_FORMS}") from None
    if address.drivername in _POSTGRES:
        return address.set(drivername="postgresql+psycopg")
    if address.drivername != "sqlite" or address.database in (None, "", ":memory:"):
        raise UnusableDatabaseError(f"a service cannot store its data in {address.drivername}; {_ADDRESS_FORMS}")
    return address


def _refuse_other_encodings(connection: Any, _record: Any) -> None:
    """Raise :class:`UnusableDatabaseError` unless the database on a server keeps its texts in UTF-8."""
    encoding = connection.info.parameter_status("server_encoding")
    if encoding != "UTF8":
        raise UnusableDatabaseError(
            f"the database is in {encoding}, and equimesh needs UTF8: create one with "
            "`createdb --template=template0 --encoding=UTF8 --owner=equimesh equimesh`"
        )


def _prepare_sqlite(connection: Any, record: Any) -> None:
    connection.isolation_level = None  # _begin_sqlite begins transactions, not the driver
    cursor = connection.cursor()
    file = cursor.execute("PRAGMA database_list").fetchone()[2]
    record.info[_READ_ONLY] = not os.access(file, os.W_OK)
    _write_ahead(cursor)
    cursor.execute("PRAGMA foreign_keys=ON")
    # Some systems build SQLite to fill what is deleted with zeros, which writes all pages of a deleted file once more.
    cursor.execute("PRAGMA secure_delete=FAST")
    cursor.close()


def _write_ahead(cursor: sqlite3.Cursor) -> None:
    """Turn WAL mode on. SQLite does not wait where another service does so in the same new file."""
    latest = time.monotonic() + _BUSY_SECONDS
    while True:
        try:
            cursor.execute("PRAGMA journal_mode=WAL")
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > latest:
                raise
        time.sleep(0.01)


def _drop_read_only(_connection: Any, record: Any) -> None:
    """Close a connection that was opened while the disk took no writes: it refuses them also when the disk is back."""
    if record.info.get(_READ_ONLY):
        record.invalidate()


def _drop_all_read_only(context: ExceptionContext) -> None:
    """Close all connections after a refused write: the disk may have changed while one of them was opened."""
    if _is_read_only(context.original_exception):
        context.is_disconnect = True
        if context.execution_context is not None:
            # SQLite keeps a closed connection until its last statement is gone.
            context.execution_context.cursor.close()


def _is_read_only(error: BaseException) -> bool:
    cause = error.orig if isinstance(error, DBAPIError) else error
    return getattr(cause, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_READONLY


def _begin_sqlite(connection: Connection) -> None:
    # A writer takes the lock at once: a transaction that first reads may fail as busy when it writes.
    options = connection.get_execution_options()
    writes, synced = options.get("writes", False), options.get("synced", False)
    if writes and connection.info.get("synced") is not synced:
        connection.exec_driver_sql(f"PRAGMA synchronous={'FULL' if synced else 'NORMAL'}")
        connection.info["synced"] = synced
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


# The revision of the tables in `schema`: that of the last step in `migrations`.
LATEST = "0010"
_FIRST = "0001"
# The revisions that this release can upgrade from.
_OLDER = (_FIRST, "0002", "0003", "0006", "0007", "0008", "0009")
_log = logging.getLogger(__name__)
# The table of Alembic, as Alembic creates it.
_version = Table("alembic_version", MetaData(), Column("version_num", String(32), primary_key=True))


def current(url: str) -> str | None:
    """The revision of the database behind ``url``; None for one without tables."""
    database = Database(url)
    try:
        with database.read() as connection:
            return _revision(connection)
    finally:
        database.close()


def upgrade(url: str) -> str:
    """Upgrade the database behind ``url`` to this release; returns its new revision.

    Raises :class:`NewerDatabaseError`.
    """
    database = Database(url)
    try:
        return prepare(database)
    finally:
        database.close()


def prepare(database: Database) -> str:
    """Create the tables, or upgrade the tables of an older release with their rows; returns the revision.

    It is one transaction, for which other services that do the same wait. Raises :class:`NewerDatabaseError`.
    """
    with database.read() as connection:
        if _revision(connection) == LATEST:
            return LATEST  # most starts end here, without a lock and without alembic
    with database.write() as connection:
        lock(connection, ["migration"])
        revision = _revision(connection)
        if revision is None:
            metadata.create_all(connection)
            _version.create(connection)
            connection.execute(insert(_version).values(version_num=LATEST))
        elif revision != LATEST:
            _log.info("the database has revision %s; it is upgraded to %s", revision, LATEST)
            _run(connection)
    return LATEST


def _revision(connection: Connection) -> str | None:
    tables = set(inspect(connection).get_table_names())
    if _version.name not in tables:
        # Release 0.1 stored no revision.
        return _FIRST if {meshes.name, artifacts.name} <= tables else None
    found = connection.execute(select(_version.c.version_num)).scalar()
    if found != LATEST and found not in _OLDER:
        raise NewerDatabaseError(
            f"the database is of revision {found}, of a newer release of equimesh or a development version; "
            f"this release knows {LATEST}: install that version again, or restore a backup from before it"
        )
    return str(found)


def _run(connection: Connection) -> None:
    from alembic import command
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", "equimesh_service.store:migrations")
    config.attributes["connection"] = connection
    command.upgrade(config, "head")


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

    def file_rows(self) -> dict[str, int]:
        """The size of every file that is a row, by its SHA-256."""
        with self._read() as connection:
            return {row.sha256: row.size for row in connection.execute(select(blobs.c.sha256, blobs.c.size))}

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
