"""The store: every SQL statement of the service, and the rules of a mesh's life.

A mesh goes ``queued -> running -> succeeded | failed | canceled``; a lost worker takes it back to ``queued``.
Every change of a mesh is one transaction that also adds an event, so the events tell the whole story.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, Row, delete, func, insert, or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.sql.elements import ColumnElement

from equimesh_service.database import Database, to_json
from equimesh_service.rows import (
    CANCELED,
    FAILED,
    QUEUED,
    RUNNING,
    SUCCEEDED,
    Artifact,
    Claim,
    EventRow,
    KeyReusedError,
    MeshRow,
    NewMesh,
    SamplesGoneError,
    SamplesRow,
)
from equimesh_service.schema import artifacts, events, idempotency, mesh_samples, meshes, metadata, samples


def _nothing() -> None:
    pass


_SHOWN = [meshes.c[name] for name in MeshRow.__dataclass_fields__]


class Store:
    """The database behind a URL. One object serves all threads of a process.

    ``durable`` asks that every commit reach the disk (the service's side); a worker's progress does not need it.
    ``clock`` gives the time in seconds since 1970.
    """

    def __init__(self, url: str, *, durable: bool = True, clock: Callable[[], float] = time.time) -> None:
        self._clock = clock
        self._database = Database(url, durable=durable)
        self._read, self._write = self._database.read, self._database.write

    def create_tables(self) -> None:
        """Make the tables that are not there yet."""
        with self._write() as connection:
            metadata.create_all(connection)

    def close(self) -> None:
        """Close all connections."""
        self._database.close()

    def check(self) -> None:
        """Raise when the database does not answer."""
        with self._read() as connection:
            connection.execute(select(func.count()).select_from(samples))

    # Meshes ------------------------------------------------------------------------------------------------

    def add_mesh(self, new: NewMesh, *, key: str | None = None, fingerprint: str = "") -> str:
        """Put a mesh into the queue and return its id: an older one's when ``key`` was seen before.

        Raises :class:`KeyReusedError` when the key came with another ``fingerprint``, and
        :class:`SamplesGoneError` when the samples were deleted.
        """
        known = self._known(key, fingerprint)
        if known is not None:
            return known
        try:
            with self._write() as connection:
                self._insert_mesh(connection, new)
                if key is not None:
                    row = {"key": key, "fingerprint": fingerprint, "mesh_id": new.id}
                    connection.execute(insert(idempotency).values(row))
        except IntegrityError:
            known = self._known(key, fingerprint)  # the same key came at the same moment
            if known is None:
                raise
            return known
        return new.id

    def mesh(self, mesh_id: str) -> MeshRow | None:
        """The mesh with this id."""
        with self._read() as connection:
            row = connection.execute(select(*_SHOWN).where(meshes.c.id == mesh_id)).first()
        return None if row is None else _mesh(row)

    def spec(self, mesh_id: str) -> dict[str, Any] | None:
        """The canonical spec of a mesh."""
        with self._read() as connection:
            text = connection.execute(select(meshes.c.spec).where(meshes.c.id == mesh_id)).scalar()
        return None if text is None else json.loads(text)

    def meshes(
        self, *, status: str | None = None, label: str | None = None, before: int | None = None, limit: int = 50
    ) -> list[MeshRow]:
        """Meshes, newest first, with ``number`` under ``before``."""
        query = select(*_SHOWN).order_by(meshes.c.number.desc()).limit(limit)
        if status is not None:
            query = query.where(meshes.c.status == status)
        if label is not None:
            query = query.where(meshes.c.label == label)
        if before is not None:
            query = query.where(meshes.c.number < before)
        with self._read() as connection:
            return [_mesh(row) for row in connection.execute(query)]

    def queued(self) -> int:
        """Number of waiting meshes."""
        query = select(func.count()).select_from(meshes).where(meshes.c.status == QUEUED)
        with self._read() as connection:
            return int(connection.execute(query).scalar_one())

    def cancel(self, mesh_id: str) -> bool:
        """Cancel a mesh that is not finished; False when it is."""
        with self._write() as connection:
            here = [meshes.c.id == mesh_id, meshes.c.status.in_((QUEUED, RUNNING))]
            change = {"status": CANCELED, "finished_at": self._clock(), "owner": None, "lease_until": None}
            return self._append(connection, here, change, "done", {"status": CANCELED})

    def delete_mesh(self, mesh_id: str, remove_file: Callable[[str], None]) -> bool:
        """Delete a mesh with its events and artifacts; files that nothing else needs go to ``remove_file``."""
        with self._write() as connection:
            query = select(artifacts.c.sha256).where(artifacts.c.mesh_id == mesh_id)
            held = set(connection.execute(query).scalars())
            for table in (events, artifacts, idempotency, mesh_samples):
                connection.execute(delete(table).where(table.c.mesh_id == mesh_id))
            gone = connection.execute(delete(meshes).where(meshes.c.id == mesh_id)).rowcount
            self._remove_unused(connection, held, remove_file)
            return bool(gone)

    # The dispatcher's side -----------------------------------------------------------------------------------

    def claim(self, owner: str, lease: float) -> Claim | None:
        """Take the oldest waiting mesh for ``owner``, for ``lease`` seconds."""
        with self._write() as connection:
            query = select(meshes.c.id).where(meshes.c.status == QUEUED).order_by(meshes.c.number).limit(1)
            mesh_id = connection.execute(query.with_for_update(skip_locked=True)).scalar()
            if mesh_id is None:
                return None
            now = self._clock()
            change = {
                "status": RUNNING,
                "attempt": meshes.c.attempt + 1,
                "owner": owner,
                "lease_until": now + lease,
                "started_at": now,
                "progress": None,
            }
            here = [meshes.c.id == mesh_id, meshes.c.status == QUEUED]
            query = select(meshes.c.attempt).where(meshes.c.id == mesh_id)
            attempt = int(connection.execute(query).scalar_one()) + 1
            data = {"status": RUNNING, "attempt": attempt}
            return Claim(mesh_id, attempt) if self._append(connection, here, change, "status", data) else None

    def renew(self, owner: str, lease: float) -> set[Claim]:
        """Extend the leases of ``owner``; returns what it still holds."""
        mine = (meshes.c.owner == owner) & (meshes.c.status == RUNNING)
        with self._write() as connection:
            connection.execute(update(meshes).where(mine).values(lease_until=self._clock() + lease))
            rows = connection.execute(select(meshes.c.id, meshes.c.attempt).where(mine))
            return {Claim(row.id, row.attempt) for row in rows}

    def abandoned(self, *, owner_gone: str | None = None) -> list[Claim]:
        """Running meshes whose lease has run out; with ``owner_gone``, all that another owner holds."""
        late = meshes.c.lease_until < self._clock()
        if owner_gone is not None:
            late = or_(late, meshes.c.owner != owner_gone)
        query = select(meshes.c.id, meshes.c.attempt).where(meshes.c.status == RUNNING, late)
        with self._read() as connection:
            return [Claim(row.id, row.attempt) for row in connection.execute(query)]

    def requeue(self, claim: Claim, reason: str) -> bool:
        """Put a running mesh back into the queue, as if it had not been claimed."""
        with self._write() as connection:
            return self._back(connection, claim, reason, 0)

    def lose(self, claim: Claim, reason: str, *, most: int, error: Mapping[str, Any]) -> str | None:
        """Note that the worker of a running mesh is lost: it waits again, or fails when ``most`` were lost.

        Returns the new status, or None when the claim no longer holds.
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
            return FAILED if self._append(connection, _held(claim), change, "done", data) else None

    # The worker's side ---------------------------------------------------------------------------------------

    def progress(self, claim: Claim, data: Mapping[str, Any]) -> bool:
        """Note how far a running mesh is; False when the claim no longer holds."""
        with self._write() as connection:
            return self._append(connection, _held(claim), {"progress": dict(data)}, "progress", data)

    def finish(
        self,
        claim: Claim,
        *,
        error: Mapping[str, Any] | None = None,
        result: Mapping[str, Any] | None = None,
        files: Sequence[Artifact] = (),
        partial: bool = False,
        publish: Callable[[], None] = _nothing,
    ) -> bool:
        """End a running mesh: succeeded, or failed with ``error``; False when the claim no longer holds.

        ``publish`` gives ``files`` their names, inside the transaction.
        """
        status = SUCCEEDED if error is None else FAILED
        data: dict[str, Any] = {"status": status}
        if error is not None:
            data["error"] = dict(error)
        with self._write() as connection:
            change = {
                "status": status,
                "finished_at": self._clock(),
                "owner": None,
                "lease_until": None,
                "error": None if error is None else dict(error),
                "result": None if result is None else dict(result),
                "partial": partial,
            }
            if not self._append(connection, _held(claim), change, "done", data):
                return False
            for file in files:
                self._insert_artifact(connection, claim.mesh_id, file)
            publish()
            return True

    # Events --------------------------------------------------------------------------------------------------

    def events(self, mesh_id: str, *, after: int = 0, limit: int = 1000) -> list[EventRow]:
        """What happened to a mesh after event number ``after``."""
        query = (
            select(events.c.number, events.c.time, events.c.kind, events.c.data)
            .where(events.c.mesh_id == mesh_id, events.c.number > after)
            .order_by(events.c.number)
            .limit(limit)
        )
        with self._read() as connection:
            return [EventRow(*row) for row in connection.execute(query)]

    # Artifacts -----------------------------------------------------------------------------------------------

    def artifact(self, mesh_id: str, name: str) -> Artifact | None:
        """The file of a mesh under a name."""
        columns = (artifacts.c.name, artifacts.c.sha256, artifacts.c.size)
        query = select(*columns).where(artifacts.c.mesh_id == mesh_id, artifacts.c.name == name)
        with self._read() as connection:
            row = connection.execute(query).first()
        return None if row is None else Artifact(*row)

    def add_artifact(self, mesh_id: str, file: Artifact, publish: Callable[[], None] = _nothing) -> bool:
        """Give a finished mesh one more file; False when the mesh is gone."""
        with self._write() as connection:
            if connection.execute(select(meshes.c.id).where(meshes.c.id == mesh_id)).first() is None:
                return False
            self._insert_artifact(connection, mesh_id, file)
            publish()
            return True

    # Samples -------------------------------------------------------------------------------------------------

    def add_samples(self, row: SamplesRow, publish: Callable[[], None] = _nothing) -> bool:
        """Keep samples; False when they were there already."""
        try:
            with self._write() as connection:
                connection.execute(insert(samples).values(vars(row)))
                publish()
        except IntegrityError:
            return False
        return True

    def samples(self, samples_id: str) -> SamplesRow | None:
        """The samples with this id."""
        with self._read() as connection:
            row = connection.execute(select(samples).where(samples.c.id == samples_id)).first()
        return None if row is None else SamplesRow(**row._mapping)

    def delete_samples(self, samples_id: str, remove_file: Callable[[str], None]) -> bool | None:
        """Delete samples. None when there are none, False when a mesh that is not finished needs them."""
        with self._write() as connection:
            sha256 = connection.execute(select(samples.c.sha256).where(samples.c.id == samples_id)).scalar()
            if sha256 is None:
                return None
            open_meshes = meshes.c.status.in_((QUEUED, RUNNING))
            uses = select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples_id)
            needs = or_(meshes.c.samples_id == samples_id, meshes.c.id.in_(uses))
            query = select(meshes.c.id).where(needs, open_meshes).limit(1)
            if connection.execute(query).first() is not None:
                return False
            connection.execute(delete(samples).where(samples.c.id == samples_id))
            self._remove_unused(connection, {sha256}, remove_file)
            return True

    # -----------------------------------------------------------------------------------------------------------

    def _known(self, key: str | None, fingerprint: str) -> str | None:
        if key is None:
            return None
        query = select(idempotency.c.fingerprint, idempotency.c.mesh_id).where(idempotency.c.key == key)
        with self._read() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None
        if row.fingerprint != fingerprint:
            raise KeyReusedError(key)
        return str(row.mesh_id)

    def _insert_mesh(self, connection: Connection, new: NewMesh) -> None:
        for name in new.samples:
            if connection.execute(select(samples.c.id).where(samples.c.id == name)).first() is None:
                raise SamplesGoneError(name)
        now = self._clock()
        row = {
            "id": new.id,
            "status": QUEUED,
            "label": new.spec["label"],
            "spec": to_json(new.spec),
            "n_xi": new.spec["grid"]["n_xi"],
            "n_eta": new.spec["grid"]["n_eta"],
            "cells": new.spec["cells"],
            "format": new.format,
            "created_at": now,
            "last_event": 1,
        }
        connection.execute(insert(meshes).values(row))
        for name in new.samples:
            connection.execute(insert(mesh_samples).values(mesh_id=new.id, samples_id=name))
        first = {"mesh_id": new.id, "number": 1, "time": now, "kind": "status", "data": {"status": QUEUED}}
        connection.execute(insert(events).values(first))

    def _back(self, connection: Connection, claim: Claim, reason: str, lost: int) -> bool:
        change = {
            "status": QUEUED,
            "owner": None,
            "lease_until": None,
            "progress": None,
            "losses": meshes.c.losses + lost,
        }
        return self._append(connection, _held(claim), change, "status", {"status": QUEUED, "reason": reason})

    def _append(
        self,
        connection: Connection,
        here: Sequence[ColumnElement[bool]],
        change: Mapping[str, Any],
        kind: str,
        data: Mapping[str, Any],
    ) -> bool:
        """Change the one mesh ``here`` and add an event that says so; False when there is none."""
        statement = update(meshes).where(*here).values(**change, last_event=meshes.c.last_event + 1)
        row = connection.execute(statement.returning(meshes.c.id, meshes.c.last_event)).first()
        if row is None:
            return False
        added = {"mesh_id": row.id, "number": row.last_event, "time": self._clock(), "kind": kind, "data": dict(data)}
        connection.execute(insert(events).values(added))
        return True

    def _insert_artifact(self, connection: Connection, mesh_id: str, file: Artifact) -> None:
        here = (artifacts.c.mesh_id == mesh_id, artifacts.c.name == file.name)
        connection.execute(delete(artifacts).where(*here))
        connection.execute(insert(artifacts).values(mesh_id=mesh_id, **vars(file)))

    def _remove_unused(self, connection: Connection, held: set[str], remove_file: Callable[[str], None]) -> None:
        # Inside the transaction: no row that names the file can be added between the look and the removal.
        for sha256 in held:
            in_artifacts = select(artifacts.c.sha256).where(artifacts.c.sha256 == sha256).limit(1)
            in_samples = select(samples.c.sha256).where(samples.c.sha256 == sha256).limit(1)
            if connection.execute(in_artifacts).first() is None and connection.execute(in_samples).first() is None:
                remove_file(sha256)


def _held(claim: Claim) -> list[ColumnElement[bool]]:
    return [meshes.c.id == claim.mesh_id, meshes.c.attempt == claim.attempt, meshes.c.status == RUNNING]


def _mesh(row: Row[Any]) -> MeshRow:
    return MeshRow(**row._mapping)
