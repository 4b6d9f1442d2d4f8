"""SQL of API keys. Keys are never deleted: after the first one, requests always need a key."""

from collections.abc import Callable, Sequence
from typing import Any

from sqlalchemy import Row, insert, select, update

from equimesh_service.store.database import Database
from equimesh_service.store.key_secrets import DEFAULT_SHARE, SCOPES, KeyRow, check_share, digest, new_secret
from equimesh_service.store.schema import keys


class KeyStore:
    """The API keys of a store."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._read, self._write = database.read, database.write
        self._clock = clock

    def create(self, name: str, scopes: Sequence[str], share: int = DEFAULT_SHARE) -> tuple[KeyRow, str]:
        """Create a key; returns it with its secret, which is not stored.

        Raises ValueError for an unknown scope, and for a share out of its bounds.
        """
        unknown = set(scopes).difference(SCOPES)
        if unknown or not scopes:
            raise ValueError(
                f"scopes are {', '.join(SCOPES)}, at least one, not {', '.join(sorted(unknown)) or 'none'}"
            )
        check_share(share)
        key_id, secret = new_secret()
        ordered = tuple(scope for scope in SCOPES if scope in scopes)
        row = KeyRow(id=key_id, name=name, sha256=digest(secret), scopes=ordered, created_at=self._clock(), share=share)
        with self._write() as connection:
            connection.execute(insert(keys).values({**vars(row), "scopes": list(ordered)}))
        return row, secret

    def list(self) -> list[KeyRow]:
        """All keys, oldest first, revoked ones too."""
        with self._read() as connection:
            return [_key(row) for row in connection.execute(select(keys).order_by(keys.c.created_at, keys.c.id))]

    def get(self, key_id: str) -> KeyRow | None:
        """The key with this id."""
        with self._read() as connection:
            row = connection.execute(select(keys).where(keys.c.id == key_id)).first()
        return None if row is None else _key(row)

    def revoke(self, key_id: str) -> bool:
        """Revoke a key for good; False for an unknown or revoked key."""
        statement = update(keys).where(keys.c.id == key_id, keys.c.revoked_at.is_(None))
        with self._write() as connection:
            return bool(connection.execute(statement.values(revoked_at=self._clock())).rowcount)

    def change(self, key_id: str, share: int) -> bool:
        """Give a key another share; False for an unknown or revoked key. Raises ValueError as :meth:`create`."""
        check_share(share)
        statement = update(keys).where(keys.c.id == key_id, keys.c.revoked_at.is_(None))
        with self._write() as connection:
            return bool(connection.execute(statement.values(share=share)).rowcount)

    def exist(self) -> bool:
        """Whether a key was ever created, revoked or not."""
        with self._read() as connection:
            return connection.execute(select(keys.c.id).limit(1)).first() is not None


def _key(row: Row[Any]) -> KeyRow:
    return KeyRow(**{**row._mapping, "scopes": tuple(row.scopes)})
