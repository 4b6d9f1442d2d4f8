"""SQL of meshes: what was asked for, what came of it, and what happened on the way."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from equimesh_service.artifacts_store import insert_artifacts, remove_unused
from equimesh_service.database import Database, to_json
from equimesh_service.quota_store import Quota, take
from equimesh_service.rows import QUEUED, Artifact, EventRow, KeyReusedError, MeshRow, NewMesh, SamplesGoneError
from equimesh_service.schema import artifacts, events, idempotency, mesh_samples, meshes, samples

# How exactly it is noted when samples were last used.
_USED_SECONDS = 3600.0
_SHOWN = [meshes.c[name] for name in MeshRow.__dataclass_fields__]


def _nothing() -> None:
    pass


class MeshesStore:
    """Meshes, with their specs, events and artifacts."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._read, self._write = database.read, database.write
        self._clock = clock

    def add(self, new: NewMesh, *, key: str | None = None, fingerprint: str = "", quota: Quota | None = None) -> str:
        """Put a mesh into the queue and return its id: an older one's when ``key`` was seen before.

        Raises :class:`KeyReusedError` when the key came with another ``fingerprint``,
        :class:`SamplesGoneError` when the samples were deleted, and
        :class:`~equimesh_service.quota_store.QuotaError` when it is one too many.
        """
        known = self._known(new.key_id, key, fingerprint)
        if known is not None:
            return known
        try:
            with self._write() as connection:
                if quota is not None:
                    take(connection, new.key_id, new.points, quota)
                self._insert(connection, new)
                if key is not None:
                    row = {"key_id": new.key_id, "key": key, "fingerprint": fingerprint, "mesh_id": new.id}
                    connection.execute(insert(idempotency).values(row))
        except IntegrityError:
            known = self._known(new.key_id, key, fingerprint)  # the same key came at the same moment
            if known is None:
                raise
            return known
        return new.id

    def get(self, mesh_id: str) -> MeshRow | None:
        """The mesh with this id."""
        with self._read() as connection:
            row = connection.execute(select(*_SHOWN).where(meshes.c.id == mesh_id)).first()
        return None if row is None else _mesh(row)

    def spec(self, mesh_id: str) -> dict[str, Any] | None:
        """The canonical spec of a mesh."""
        with self._read() as connection:
            text = connection.execute(select(meshes.c.spec).where(meshes.c.id == mesh_id)).scalar()
        return None if text is None else json.loads(text)

    def page(
        self,
        *,
        key_id: str | None = None,
        status: str | None = None,
        label: str | None = None,
        before: int | None = None,
        limit: int = 50,
    ) -> list[MeshRow]:
        """Meshes, newest first, with ``number`` under ``before``; those of one key, unless that is None."""
        query = select(*_SHOWN).order_by(meshes.c.number.desc()).limit(limit)
        if key_id is not None:
            query = query.where(meshes.c.key_id == key_id)
        if status is not None:
            query = query.where(meshes.c.status == status)
        if label is not None:
            query = query.where(meshes.c.label == label)
        if before is not None:
            query = query.where(meshes.c.number < before)
        with self._read() as connection:
            return [_mesh(row) for row in connection.execute(query)]

    def delete(self, mesh_id: str, remove_file: Callable[[str], None]) -> bool:
        """Delete a mesh with its events and artifacts; files that nothing else needs go to ``remove_file``."""
        with self._write() as connection:
            held = delete_mesh(connection, mesh_id)
        remove_unused(self._database, held or (), remove_file)
        return held is not None

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
            query = select(meshes.c.id).where(meshes.c.id == mesh_id).with_for_update(key_share=True)
            if connection.execute(query).first() is None:
                return False
            insert_artifacts(connection, mesh_id, [file])
            publish()
            return True

    def _known(self, key_id: str, key: str | None, fingerprint: str) -> str | None:
        if key is None:
            return None
        here = (idempotency.c.key_id == key_id, idempotency.c.key == key)
        query = select(idempotency.c.fingerprint, idempotency.c.mesh_id).where(*here)
        with self._read() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None
        if row.fingerprint != fingerprint:
            raise KeyReusedError(key)
        return str(row.mesh_id)

    def _insert(self, connection: Connection, new: NewMesh) -> None:
        now = self._clock()
        for name in sorted(new.samples):
            # Locked, so that they are not deleted before this mesh is there to need them.
            query = select(samples.c.used_at).where(samples.c.id == name).with_for_update(read=True, key_share=True)
            used_at = connection.execute(query).scalar()
            if used_at is None:
                raise SamplesGoneError(name)
            if used_at < now - _USED_SECONDS:
                connection.execute(update(samples).where(samples.c.id == name).values(used_at=now))
        row = {
            "id": new.id,
            "status": QUEUED,
            "label": new.spec["label"],
            "spec": to_json(new.spec),
            "n_xi": new.spec["grid"]["n_xi"],
            "n_eta": new.spec["grid"]["n_eta"],
            "cells": new.spec["cells"],
            "format": new.format,
            "key_id": new.key_id,
            "created_at": now,
            "request_id": new.request_id,
            "trace": new.trace,
            "last_event": 1,
        }
        connection.execute(insert(meshes).values(row))
        for name in new.samples:
            connection.execute(insert(mesh_samples).values(mesh_id=new.id, samples_id=name))
        first = {"mesh_id": new.id, "number": 1, "time": now, "kind": "status", "data": {"status": QUEUED}}
        connection.execute(insert(events).values(first))


def delete_mesh(connection: Connection, mesh_id: str) -> set[str] | None:
    """Delete the rows of a mesh, and give its files, for :func:`remove_unused`; None when there is no such mesh."""
    here = meshes.c.id == mesh_id
    # Locked, so that no worker gives it a file that is not seen here.
    if connection.execute(select(meshes.c.id).where(here).with_for_update()).first() is None:
        return None
    held = set(connection.execute(select(artifacts.c.sha256).where(artifacts.c.mesh_id == mesh_id)).scalars())
    for table in (events, artifacts, idempotency, mesh_samples):
        connection.execute(delete(table).where(table.c.mesh_id == mesh_id))
    connection.execute(delete(meshes).where(here))
    return held


def _mesh(row: Row[Any]) -> MeshRow:
    return MeshRow(**row._mapping)
