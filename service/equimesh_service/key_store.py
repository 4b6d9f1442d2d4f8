"""SQL of the API keys."""

from __future__ import annotations

from collections.abc import Callable

from sqlalchemy import select

from equimesh_service.database import Database
from equimesh_service.schema import keys


class KeyStore:
    """The API keys, by the SHA-256 of their secrets."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._read, self._write = database.read, database.write
        self._clock = clock

    def exist(self) -> bool:
        """Whether a key was ever created, revoked ones included."""
        with self._read() as connection:
            return connection.execute(select(keys.c.id).limit(1)).first() is not None
