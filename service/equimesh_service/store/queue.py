"""SQL of the queue: the claims of meshes, and their ends.

A mesh goes ``queued -> running -> succeeded | failed | canceled``; when its worker is lost, it is ``queued`` again.
Every change of a mesh is one transaction that also adds an event, so the events are complete.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Select, bindparam, func, insert, or_, select, update
from sqlalchemy.sql.dml import ReturningUpdate

from equimesh_service.store.database import Database
from equimesh_service.store.keys import DEFAULT_SHARE
from equimesh_service.store.mesh_rows import (
    insert_artifacts,
    removal_lookup,
)
from equimesh_service.store.rows import (
    CANCELED,
    FAILED,
    QUEUED,
    RUNNING,
    STATUSES,
    Claim,
    KeysInQueue,
    Outcome,
    QueueCounts,
)
from equimesh_service.store.schema import events, keys, meshes

# Statements are built once, since building them takes longer than executing them. A change takes the mesh, and the new
# values of further columns by their names.
_CLAIMED = [meshes.c.id, meshes.c.attempt, meshes.c.request_id, meshes.c.key_id, meshes.c.trace]
# The key is compared as a range, and is part of the order. With an equation, PostgreSQL may look for the oldest mesh
# among all meshes in the order of their numbers, and not in the index of those that wait.
_OLDEST_OF_KEY = (
    select(*_CLAIMED, meshes.c.created_at)
    .where(meshes.c.status == QUEUED, meshes.c.key_id.between(bindparam("key"), bindparam("key")))
    .order_by(meshes.c.key_id, meshes.c.number)
    .limit(1)
    .with_for_update(skip_locked=True)
)
_CREATED_AT = select(meshes.c.created_at).where(meshes.c.number == bindparam("oldest"))
_RUNNING_OF_KEYS = select(meshes.c.key_id, func.count()).where(meshes.c.status == RUNNING).group_by(meshes.c.key_id)


def _keys_in_queue() -> Select[tuple[str, int, int]]:
    """The query for the keys with waiting meshes, their shares and the numbers of their oldest ones, in this order.

    It jumps from key to key in the index, so that it reads a row for each key and not for each mesh.
    """
    # Not by min(), for which PostgreSQL may read all waiting meshes where it expects few.
    queued = select(meshes.c.key_id).where(meshes.c.status == QUEUED).order_by(meshes.c.key_id, meshes.c.number)
    found = select(queued.limit(1).scalar_subquery().label("key_id")).cte(recursive=True)
    later = queued.where(meshes.c.key_id > found.c.key_id).limit(1).scalar_subquery()
    found = found.union_all(select(later).where(found.c.key_id.is_not(None)))
    mine = meshes.c.key_id.between(found.c.key_id, found.c.key_id)
    oldest = queued.with_only_columns(meshes.c.number).where(mine).limit(1).scalar_subquery().label("oldest")
    share = func.coalesce(keys.c.share, DEFAULT_SHARE).label("share")
    joined = found.outerjoin(keys, keys.c.id == found.c.key_id)
    query = select(found.c.key_id, share, oldest).select_from(joined).where(found.c.key_id.is_not(None))
    return query.order_by(oldest)


_KEYS_IN_QUEUE = _keys_in_queue()
_CHANGE = (
    update(meshes)
    .where(meshes.c.id == bindparam("mesh"))
    .values(last_event=meshes.c.last_event + 1)
    .returning(meshes.c.id, meshes.c.last_event)
)
_CLAIM = _CHANGE.where(meshes.c.status == QUEUED)
_CANCEL = _CHANGE.where(meshes.c.status.in_((QUEUED, RUNNING)))
_ATTEMPT = _CHANGE.where(meshes.c.status == RUNNING, meshes.c.attempt == bindparam("try"))
_BACK = _ATTEMPT.values(losses=meshes.c.losses + bindparam("lost"))
_ADD_EVENT = insert(events)
_SUCCESS = Outcome()


class QueueStore:
    """Waiting and running meshes: the part of the store for the dispatcher and the workers."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._read, self._write = database.read, database.write
        self._clock = clock

    def count_waiting(self) -> int:
        """The number of waiting meshes."""
        query = select(func.count()).select_from(meshes).where(meshes.c.status == QUEUED)
        with self._read() as connection:
            return int(connection.execute(query).scalar_one())

    def count(self) -> QueueCounts:
        """The number of meshes of each status, and the wait of the oldest waiting one."""
        query = select(meshes.c.status, func.count()).group_by(meshes.c.status)
        with self._read() as connection:
            counted = {status: int(count) for status, count in connection.execute(query)}
            first = connection.execute(_KEYS_IN_QUEUE).first()
            since = None if first is None else connection.execute(_CREATED_AT, {"oldest": first.oldest}).scalar()
        waited = 0.0 if since is None else max(0.0, self._clock() - since)
        return QueueCounts(meshes={status: counted.get(status, 0) for status in STATUSES}, oldest_wait=waited)

    def cancel(self, mesh_id: str) -> bool:
        """Cancel a mesh that is not finished; False when it is."""
        with self._write() as connection:
            change = {"status": CANCELED, "finished_at": self._clock(), "owner": None, "lease_until": None}
            return self._append(connection, _CANCEL, {"mesh": mesh_id, **change}, "done", {"status": CANCELED})

    def find_waiting(self) -> KeysInQueue:
        """The keys with waiting meshes."""
        with self._read() as connection:
            shares = {row.key_id: int(row.share) for row in connection.execute(_KEYS_IN_QUEUE)}
            running = {key_id: int(count) for key_id, count in connection.execute(_RUNNING_OF_KEYS)} if shares else {}
        return KeysInQueue(shares=shares, running=running)

    def claim(self, owner: str, lease: float, key_id: str = "") -> Claim | None:
        """Claim the oldest waiting mesh of a key for ``owner``, for ``lease`` seconds; a crash may undo it.

        None when the key has none, or another service is claiming its only one.
        """
        with self._write(durable=False) as connection:
            row = connection.execute(_OLDEST_OF_KEY, {"key": key_id}).first()
            if row is None:
                return None
            now = self._clock()
            change = {
                "status": RUNNING,
                "attempt": row.attempt + 1,
                "owner": owner,
                "lease_until": now + lease,
                "started_at": now,
                "progress": None,
            }
            data = {"status": RUNNING, "attempt": row.attempt + 1}
            if not self._append(connection, _CLAIM, {"mesh": row.id, **change}, "status", data):
                return None
            waited = max(0.0, now - row.created_at)
            return replace(_claim(row), attempt=row.attempt + 1, claimed_at=now, waited=waited)

    def find_held(self, owner: str) -> set[Claim]:
        """The claims of ``owner``."""
        mine = (meshes.c.owner == owner) & (meshes.c.status == RUNNING)
        with self._read() as connection:
            return {Claim(*row) for row in connection.execute(select(meshes.c.id, meshes.c.attempt).where(mine))}

    def renew(self, owner: str, lease: float) -> set[Claim]:
        """Extend the leases of ``owner``; returns its claims."""
        mine = (meshes.c.owner == owner) & (meshes.c.status == RUNNING)
        with self._write(durable=False) as connection:
            connection.execute(update(meshes).where(mine).values(lease_until=self._clock() + lease))
            rows = connection.execute(select(meshes.c.id, meshes.c.attempt).where(mine))
            return {Claim(row.id, row.attempt) for row in rows}

    def find_abandoned(self, *, owner_gone: str | None = None) -> list[Claim]:
        """The claims of running meshes whose lease has expired; with ``owner_gone``, of all other owners, too."""
        late = meshes.c.lease_until < self._clock()
        if owner_gone is not None:
            late = or_(late, meshes.c.owner != owner_gone)
        query = select(*_CLAIMED).where(meshes.c.status == RUNNING, late)
        with self._read() as connection:
            return [_claim(row) for row in connection.execute(query)]

    def requeue(self, claim: Claim, reason: str) -> bool:
        """Put a running mesh back into the queue, without counting a loss."""
        with self._write() as connection:
            return self._back(connection, claim, reason, 0)

    def lose(self, claim: Claim, reason: str, *, most: int, error: Mapping[str, Any]) -> str | None:
        """Record that the worker of a running mesh is lost: the mesh waits again, or fails after ``most`` losses.

        Returns the new status, or None when the claim is no longer valid.
        """
        with self._write() as connection:
            query = select(meshes.c.losses).where(meshes.c.id == claim.mesh_id)
            losses = int(connection.execute(query).scalar() or 0) + 1
            if losses < most:
                return QUEUED if self._back(connection, claim, reason, 1) else None
            change = {
                "status": FAILED,
                "finished_at": self._clock(),
                "owner": None,
                "lease_until": None,
                "losses": losses,
                "error": dict(error),
            }
            data = {"status": FAILED, "error": dict(error)}
            return FAILED if self._append(connection, _ATTEMPT, {**_of(claim), **change}, "done", data) else None

    def progress(self, claim: Claim, data: Mapping[str, Any]) -> bool:
        """Store the progress of a running mesh; False when the claim is no longer valid. A crash may undo it."""
        with self._write(durable=False) as connection:
            return self._append(connection, _ATTEMPT, {**_of(claim), "progress": dict(data)}, "progress", data)

    def finish(self, claim: Claim, outcome: Outcome = _SUCCESS) -> bool:
        """End a running mesh; False when the claim is no longer valid. The files are published in the transaction.

        A crash of the machine may undo it: then the mesh, which stays in the store, is computed once more.
        """
        with self._write(durable=False) as connection:
            change = {**outcome.columns, "finished_at": self._clock(), "owner": None, "lease_until": None}
            if not self._append(connection, _ATTEMPT, {**_of(claim), **change}, "done", outcome.event):
                return False
            insert_artifacts(connection, claim.mesh_id, outcome.files)
            outcome.publish(removal_lookup(connection))
            return True

    def _back(self, connection: Connection, claim: Claim, reason: str, lost: int) -> bool:
        change = {"status": QUEUED, "owner": None, "lease_until": None, "progress": None, "lost": lost}
        return self._append(connection, _BACK, {**_of(claim), **change}, "status", {"status": QUEUED, "reason": reason})

    def _append(
        self,
        connection: Connection,
        change: ReturningUpdate[Any],
        values: Mapping[str, Any],
        kind: str,
        data: Mapping[str, Any],
    ) -> bool:
        """Change one mesh, and add an event; False when the condition of the change does not hold."""
        row = connection.execute(change, dict(values)).first()
        if row is None:
            return False
        added = {"mesh_id": row.id, "number": row.last_event, "time": self._clock(), "kind": kind, "data": dict(data)}
        connection.execute(_ADD_EVENT, added)
        return True


def _claim(row: Any) -> Claim:
    return Claim(row.id, row.attempt, request_id=row.request_id, key_id=row.key_id, trace=row.trace)


def _of(claim: Claim) -> dict[str, Any]:
    return {"mesh": claim.mesh_id, "try": claim.attempt}
