"""API keys and their SQL: secrets, scopes, and what a key uses."""

from __future__ import annotations

import hmac
import re
import secrets
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from sqlalchemy import BigInteger, Connection, Row, cast, func, insert, select, update

from equimesh_service.errors import QuotaError
from equimesh_service.store.database import Database, lock
from equimesh_service.store.rows import QUEUED, RUNNING
from equimesh_service.store.schema import artifacts, keys, meshes, samples, samples_keys

# To look at meshes and samples.
READ = "read"
# To request, cancel and delete them, too.
WRITE = "write"
# To see those of all keys, too, and the metrics.
ADMIN = "admin"
SCOPES = (READ, WRITE, ADMIN)
# The scopes that a scope includes.
_INCLUDED = {READ: {READ}, WRITE: {READ, WRITE}, ADMIN: {READ, WRITE, ADMIN}}
# How many meshes a key starts while another key starts one, when both have meshes waiting.
DEFAULT_SHARE = 1
# Larger shares would starve other keys for long.
MAX_SHARE = 100
# A mesh in flight is finished, refused or in the store after this time, but for one whose check takes long.
MAX_FLIGHT_SECONDS = 0.4
# The time between two looks at the store, while a mesh in flight may take what is left of a limit.
_LOOK_SECONDS = 0.02
_SECRET = re.compile(r"em_([0-9a-f]{12})_[A-Za-z0-9_-]{43}")


@dataclass(frozen=True, kw_only=True)
class KeyRow:
    """A key as it is stored, with the hash of its secret."""

    id: str
    name: str
    sha256: str
    scopes: tuple[str, ...]
    created_at: float
    revoked_at: float | None = None
    share: int = DEFAULT_SHARE

    def is_valid(self, mark: str) -> bool:
        """Whether the key has the secret with this hash, and is not revoked."""
        # In a time that does not depend on the hashes.
        return hmac.compare_digest(self.sha256, mark) and self.revoked_at is None


def check_share(share: int) -> None:
    """Raise ValueError for a share out of its bounds."""
    if not 1 <= share <= MAX_SHARE:
        raise ValueError(f"the share of a key is 1 to {MAX_SHARE}, not {share}")


def new_secret() -> tuple[str, str]:
    """A new id, and a secret that contains it: 256 random bits, so that a plain hash hides them."""
    key_id = secrets.token_hex(6)
    return key_id, f"em_{key_id}_{secrets.token_urlsafe(32)}"


def id_of(secret: str) -> str | None:
    """The id in a secret, None for a text that is no secret."""
    match = _SECRET.fullmatch(secret)
    return None if match is None else match[1]


def digest(secret: str) -> str:
    """The SHA-256 of a secret, as it is stored."""
    return sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def expand_scopes(scopes: Iterable[str]) -> frozenset[str]:
    """The scopes and all that they include: write includes read, admin includes both."""
    return frozenset[str]().union(*(_INCLUDED[scope] for scope in scopes))


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


@dataclass(frozen=True, kw_only=True)
class Quota:
    """The most unfinished meshes of a key and the most points of them; 0: no limit.

    ``in_flight`` are the meshes of the key that a service computed at some time and that may not have been in the store
    yet. Each of them has at most ``most_points``.
    """

    queued: int
    points: int
    in_flight: tuple[str, ...] = ()
    most_points: int = 0


def take(connection: Connection, key_id: str, points: int, quota: Quota) -> None:
    """Check that one more mesh fits, in this writing transaction; raises :class:`QuotaError`.

    Until the transaction ends, no other one in any process checks the same key, so the limit holds exactly.
    """
    if not (quota.queued or quota.points):
        return
    lock(connection, [f"quota {key_id}"])
    number, used = _usage(connection, key_id)
    _refuse(number, used, points, quota)


def _usage(connection: Connection, key_id: str) -> tuple[int, int]:
    """The number of a key's unfinished meshes in the store, and their points."""
    # `coalesce` keeps the query from the index of all meshes of the key, most of which are finished.
    mine = func.coalesce(meshes.c.key_id, "") == key_id
    # With 64 bits: a mesh on a cluster may have more points than 32 bits count.
    total = func.coalesce(func.sum(cast(meshes.c.n_xi, BigInteger) * meshes.c.n_eta), 0)
    query = select(func.count(), total).where(meshes.c.status.in_((QUEUED, RUNNING)), mine)
    number, used = connection.execute(query).one()
    return int(number), int(used)


def _refuse(number: int, used: int, points: int, quota: Quota) -> None:
    """Raise :class:`QuotaError` where one more mesh does not fit next to others."""
    if quota.queued and number >= quota.queued:
        raise QuotaError("key_max_queued", number, quota.queued)
    if quota.points and used + points > quota.points:
        raise QuotaError("key_max_points", used, quota.points)


def _fits(number: int, used: int, points: int, quota: Quota) -> bool:
    try:
        _refuse(number, used, points, quota)
    except QuotaError:
        return False
    return True


def _count_unknown(connection: Connection, names: tuple[str, ...]) -> int:
    """How many of these meshes are not in the store."""
    if not names:
        return 0
    known = connection.execute(select(func.count()).where(meshes.c.id.in_(names))).scalar_one()
    return len(names) - int(known)


class QuotaStore:
    """The usage of keys."""

    def __init__(self, database: Database) -> None:
        self._read = database.read

    def fits(self, key_id: str, points: int, quota: Quota) -> bool:
        """Whether one more mesh is sure to fit, next to all of ``quota.in_flight``.

        Raises :class:`QuotaError` where it does not fit next to those in the store.
        """
        if not (quota.queued or quota.points):
            return True
        number, used, flying = self._usage_beside(key_id, quota.in_flight)
        _refuse(number, used, points, quota)
        return _fits(number + flying, used + flying * quota.most_points, points, quota)

    def check(self, key_id: str, points: int, current: Callable[[], Quota]) -> None:
        """Check that one more mesh fits next to those in flight, by the ``current`` quota; raises :class:`QuotaError`.

        Where it is not known to fit, this waits until those are in the store or gone, for :data:`MAX_FLIGHT_SECONDS` at
        most. One that is still in flight after that counts as a mesh, without points, which are not known.
        """
        until = time.monotonic() + MAX_FLIGHT_SECONDS
        while not self.fits(key_id, points, quota := current()):
            if time.monotonic() > until:
                number, used, flying = self._usage_beside(key_id, quota.in_flight)
                _refuse(number + flying, used, points, quota)
                return
            time.sleep(_LOOK_SECONDS)

    def _usage_beside(self, key_id: str, names: tuple[str, ...]) -> tuple[int, int, int]:
        """The number of a key's unfinished meshes in the store, their points, and how many of ``names`` it lacks."""
        with self._read() as connection:
            return *_usage(connection, key_id), _count_unknown(connection, names)

    def stored_bytes(self, key_id: str) -> int:
        """Bytes of the files and specs of a key's meshes, and of its samples.

        A file that several share counts for each.
        """
        specs = select(func.coalesce(func.sum(meshes.c.spec_size), 0))
        files = select(func.coalesce(func.sum(artifacts.c.size), 0)).join(meshes, meshes.c.id == artifacts.c.mesh_id)
        uploads = select(func.coalesce(func.sum(samples.c.size), 0)).join(
            samples_keys, samples_keys.c.samples_id == samples.c.id
        )
        with self._read() as connection:
            made = connection.execute(files.where(meshes.c.key_id == key_id)).scalar_one()
            sent = connection.execute(uploads.where(samples_keys.c.key_id == key_id)).scalar_one()
            specified = connection.execute(specs.where(meshes.c.key_id == key_id)).scalar_one()
        return int(made) + int(sent) + int(specified)
