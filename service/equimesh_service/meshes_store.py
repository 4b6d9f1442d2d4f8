"""SQL of meshes: what was asked for, what came of it, and what happened on the way."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, Row, delete, insert, select
from sqlalchemy.exc import IntegrityError

from equimesh_service.artifacts_store import insert_artifact, remove_unused
from equimesh_service.database import Database, to_json
from equimesh_service.rows import QUEUED, Artifact, EventRow, KeyReusedError, MeshRow, NewMesh, SamplesGoneError
from equimesh_service.schema import artifacts, events, idempotency, mesh_samples, meshes, samples

_SHOWN = [meshes.c[name] for name in MeshRow.__dataclass_fields__]


def _nothing() -> None:
    pass


class MeshesStore:
    """Meshes, with their specs, events and artifacts."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._read, self._write = database.read, database.write
        self._clock = clock

    def add(self, new: NewMesh, *, key: str | None = None, fingerprint: str = "") -> str:
        """Put a mesh into the queue and return its id: an older one's when ``key`` was seen before.

        Raises :class:`KeyReusedError` when the key came with another ``fingerprint``, and
        :class:`SamplesGoneError` when the samples were deleted.
        """
        known = self._known(key, fingerprint)
        if known is not None:
            return known
        try:
            with self._write() as connection:
                self._insert(connection, new)
                if key is not None:
                    row = {"key": key, "fingerprint": fingerprint, "mesh_id": new.id}
                    connection.execute(insert(idempotency).values(row))
        except IntegrityError:
            known = self._known(key, fingerprint)  # the same key came at the same moment
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

    def delete(self, mesh_id: str, remove_file: Callable[[str], None]) -> bool:
        """Delete a mesh with its events and artifacts; files that nothing else needs go to ``remove_file``."""
        with self._write() as connection:
            query = select(artifacts.c.sha256).where(artifacts.c.mesh_id == mesh_id)
            held = set(connection.execute(query).scalars())
            for table in (events, artifacts, idempotency, mesh_samples):
                connection.execute(delete(table).where(table.c.mesh_id == mesh_id))
            gone = connection.execute(delete(meshes).where(meshes.c.id == mesh_id)).rowcount
            remove_unused(connection, held, remove_file)
            return bool(gone)

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
            if connection.execute(select(meshes.c.id).where(meshes.c.id == mesh_id)).first() is None:
                return False
            insert_artifact(connection, mesh_id, file)
            publish()
            return True

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

    def _insert(self, connection: Connection, new: NewMesh) -> None:
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
            "request_id": new.request_id,
            "trace": new.trace,
            "last_event": 1,
        }
        connection.execute(insert(meshes).values(row))
        for name in new.samples:
            connection.execute(insert(mesh_samples).values(mesh_id=new.id, samples_id=name))
        first = {"mesh_id": new.id, "number": 1, "time": now, "kind": "status", "data": {"status": QUEUED}}
        connection.execute(insert(events).values(first))


def _mesh(row: Row[Any]) -> MeshRow:
    return MeshRow(**row._mapping)
