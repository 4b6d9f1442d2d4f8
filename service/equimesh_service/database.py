"""A database behind a URL: connections and transactions. SQLite is used in WAL mode, by many processes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from sqlalchemy import Connection, create_engine, event


class Database:
    """Reading and writing transactions, for all threads of a process.

    ``durable`` asks that every commit be on disk when it returns; without it a crash of the machine, but not
    one of the process, may undo the last commits.
    """

    def __init__(self, url: str, *, durable: bool) -> None:
        sqlite = url.startswith("sqlite")
        arguments = {"timeout": 30.0, "check_same_thread": False} if sqlite else {}
        self._engine = create_engine(url, connect_args=arguments, json_serializer=to_json, pool_size=8, max_overflow=64)
        if sqlite:
            event.listen(self._engine, "connect", _prepare_sqlite(durable))
            event.listen(self._engine, "begin", _begin_sqlite)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """A transaction that only reads."""
        with self._engine.connect() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """A transaction that is committed at the end, or undone by an exception."""
        with self._engine.connect().execution_options(writes=True) as connection, connection.begin():
            yield connection

    def close(self) -> None:
        """Close all connections."""
        self._engine.dispose()


def to_json(value: Any) -> str:
    """Compact JSON; raises ValueError for what JSON cannot carry."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=False)


def _prepare_sqlite(durable: bool) -> Callable[[Any, Any], None]:
    def prepare(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # transactions begin where _begin_sqlite says, not where the driver guesses
        cursor = connection.cursor()
        cursor.execute("PRAGMA journal_mode=WAL")
        cursor.execute(f"PRAGMA synchronous={'FULL' if durable else 'NORMAL'}")
        cursor.execute("PRAGMA foreign_keys=ON")
        cursor.close()

    return prepare


def _begin_sqlite(connection: Connection) -> None:
    # A writer takes the lock at once: upgrading a read later could fail as busy.
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
