"""A database behind a URL: connections and transactions.

SQLite is used in WAL mode, by many processes. PostgreSQL is used with "read committed" transactions: a writer locks the
rows that must not change meanwhile, or takes a lock by name.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from threading import RLock
from typing import Any

from sqlalchemy import Connection, Table, create_engine, event, func, select, text
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError
from sqlalchemy.sql.dml import ReturningInsert

from equimesh_service.errors import UnusableDatabaseError
from equimesh_service.store.clock import ServerClock

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

    With ``durable`` every commit is on disk when it returns. Without, a crash of the machine may undo the last commits;
    a crash of the process does not. ``clock`` returns the database's time in seconds since 1970; that of SQLite is this
    machine's. Raises :class:`UnusableDatabaseError`.
    """

    def __init__(self, url: str, *, durable: bool) -> None:
        self._durable = durable
        address = _address(url)
        # SQLite has one writer at a time; others sleep for longer and longer. The threads of this process wait here
        # instead, where they wake at once.
        self._turns: AbstractContextManager[object] = nullcontext()
        self._server_clock = None if address.get_backend_name() == "sqlite" else ServerClock(self.read)
        self.clock: Callable[[], float] = self._server_clock or time.time
        if address.get_backend_name() == "sqlite":
            self._turns = RLock()
            arguments: dict[str, Any] = {"timeout": 30.0, "check_same_thread": False}
            self._engine = create_engine(
                address, connect_args=arguments, json_serializer=to_json, pool_size=8, max_overflow=64
            )
            event.listen(self._engine, "connect", _prepare_sqlite)
            event.listen(self._engine, "begin", _begin_sqlite)
        else:
            if find_spec("psycopg") is None:
                raise UnusableDatabaseError(
                    "PostgreSQL needs psycopg; install it with: pip install 'equimesh[postgres]'"
                )
            more = str(address.query.get("options", ""))
            options = [_IDLE_OPTION, "" if durable else "-c synchronous_commit=off", more]
            self._engine = create_engine(
                address,
                connect_args={"connect_timeout": _CONNECT_SECONDS, "options": " ".join(options), **_KEEPALIVE},
                json_serializer=to_json,
                pool_size=8,
                max_overflow=8,
                pool_pre_ping=True,  # replaces connections from before a restart of the server
            )
            # Before the driver of SQLAlchemy asks for anything, which fails with other encodings.
            event.listen(self._engine, "connect", _refuse_other_encodings, insert=True)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A transaction that only reads."""
        with self._engine.connect() as connection:
            if self._server_clock is not None:
                self._server_clock.follow(connection)
            yield connection

    @contextmanager
    def write(self, *, durable: bool = True) -> Iterator[Connection]:
        """A transaction that is committed at the end, or undone by an exception.

        Without ``durable`` its commit does not wait for the disk. It reaches the disk with the next durable commit at
        the latest, since both are written to the same log.
        """
        synced = self._durable and durable
        with (
            self._turns,
            self._engine.connect().execution_options(writes=True, synced=synced) as connection,
            connection.begin(),
        ):
            if self._durable and not durable and connection.dialect.name == "postgresql":
                connection.execute(text("SET LOCAL synchronous_commit TO off"))
            if self._server_clock is not None:
                self._server_clock.follow(connection)
            yield connection

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def lock(connection: Connection, names: Iterable[str]) -> None:
    """Lock ``names`` until the end of this writing transaction; other transactions wait for them."""
    if connection.dialect.name == "postgresql":  # SQLite has one writer at a time anyway
        for name in sorted(set(names)):  # in order, against deadlocks
            number = int.from_bytes(sha256(name.encode()).digest()[:8], "big", signed=True)
            connection.execute(select(func.pg_advisory_xact_lock(number)))


def insert_new(connection: Connection, table: Table, row: Mapping[str, Any]) -> bool:
    """Insert a row; False when a row with its key exists, which is not changed."""
    return connection.execute(_insert_new(table, connection.dialect.name), dict(row)).first() is not None


@cache  # to build a statement takes several times longer than to execute it
def _insert_new(table: Table, dialect: str) -> ReturningInsert[Any]:
    make = postgresql.insert if dialect == "postgresql" else sqlite.insert
    return make(table).on_conflict_do_nothing().returning(*table.primary_key)


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


def _prepare_sqlite(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # _begin_sqlite begins transactions, not the driver
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    # A writer takes the lock at once: a transaction that first reads may fail as busy when it writes.
    options = connection.get_execution_options()
    writes, synced = options.get("writes", False), options.get("synced", False)
    if writes and connection.info.get("synced") is not synced:
        connection.exec_driver_sql(f"PRAGMA synchronous={'FULL' if synced else 'NORMAL'}")
        connection.info["synced"] = synced
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
