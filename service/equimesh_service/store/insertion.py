"""SQL that inserts meshes, with the events that lead to their states."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, bindparam, insert, select, update

from equimesh_service.errors import SamplesGoneError
from equimesh_service.store.artifacts import insert_artifacts
from equimesh_service.store.database import to_json
from equimesh_service.store.rows import QUEUED, RUNNING, SUCCEEDED, Artifact, Lease, NewMesh, Outcome
from equimesh_service.store.schema import artifacts, events, mesh_samples, meshes, samples

# How exactly the time of the last use of samples is stored.
_USED_AT_PRECISION_SECONDS = 3600.0
# Statements are built once, since building them takes longer than executing them.
_INSERT_MESH = insert(meshes)
_INSERT_USES = insert(mesh_samples)
_INSERT_EVENTS = insert(events)
_USED_AT = select(samples.c.used_at).where(samples.c.id == bindparam("name")).with_for_update(read=True, key_share=True)


def insert_waiting(connection: Connection, new: NewMesh, lease: Lease | None, now: float) -> None:
    """Insert a mesh that waits in the queue, or with a ``lease`` one that already runs."""
    if lease is None:
        _insert(connection, new, now, {"status": QUEUED}, [("status", {"status": QUEUED})])
        use_samples(connection, new, now)
        return
    state = {"attempt": 1, "owner": lease.owner, "lease_until": now + lease.seconds, "started_at": now}
    began: dict[str, Any] = {"status": RUNNING, "attempt": 1}
    story = [("status", {"status": QUEUED}), ("status", began)]
    _insert(connection, new, now, {"status": RUNNING, **state}, story)
    use_samples(connection, new, now)


def insert_finished(connection: Connection, new: NewMesh, outcome: Outcome, now: float, seconds: float) -> None:
    """Insert a mesh that a worker has finished, after ``seconds`` of work, as its first attempt.

    Its samples and files follow.
    """
    began = now - seconds
    state = {**outcome.columns, "attempt": 1, "created_at": began, "started_at": began, "finished_at": now}
    began_event: dict[str, Any] = {"status": RUNNING, "attempt": 1}
    story: list[tuple[str, Mapping[str, Any]]] = [
        ("status", {"status": QUEUED}),
        ("status", began_event),
        ("done", outcome.event),
    ]
    _insert(connection, new, now, state, story)


def insert_reused(connection: Connection, new: NewMesh, source: str, result: Mapping[str, Any], now: float) -> None:
    """Insert a mesh that has succeeded, with the result and the files of the mesh ``source``."""
    kept = {key: value for key, value in (result or {}).items() if key != "timings"}
    state = {"status": SUCCEEDED, "finished_at": now, "result": kept, "reused_from": source}
    done = {"status": SUCCEEDED, "reused_from": source}
    _insert(connection, new, now, state, [("done", done)])
    use_samples(connection, new, now)
    columns = (artifacts.c.name, artifacts.c.sha256, artifacts.c.size)
    files = connection.execute(select(*columns).where(artifacts.c.mesh_id == source)).all()
    insert_artifacts(connection, new.id, [Artifact(*file) for file in files])


def _insert(
    connection: Connection,
    new: NewMesh,
    now: float,
    state: Mapping[str, Any],
    story: Sequence[tuple[str, Mapping[str, Any]]],
) -> None:
    """Insert a mesh in a state, and the events that lead to it."""
    spec = to_json(new.spec)
    row = {
        "id": new.id,
        "label": new.spec["label"],
        "spec": spec,
        "spec_size": len(spec.encode()),
        "n_xi": new.shape[0],
        "n_eta": new.shape[1],
        "cells": new.spec["cells"],
        "format": new.format,
        "key_id": new.key_id,
        "fingerprint": new.fingerprint,
        "created_at": now,
        "request_id": new.request_id,
        "trace": new.trace,
        "last_event": len(story),
        **state,
    }
    connection.execute(_INSERT_MESH, row)
    rows = [
        {"mesh_id": new.id, "number": number, "time": now, "kind": kind, "data": dict(data)}
        for number, (kind, data) in enumerate(story, start=1)
    ]
    connection.execute(_INSERT_EVENTS, rows)


def use_samples(connection: Connection, new: NewMesh, now: float) -> None:
    """Note that a mesh which was just inserted uses its samples, and the time of their use.

    They are locked, so that they are not deleted before the transaction ends.
    """
    for name in sorted(new.samples):
        used_at = connection.execute(_USED_AT, {"name": name}).scalar()
        if used_at is None:
            raise SamplesGoneError(name)
        if used_at < now - _USED_AT_PRECISION_SECONDS:
            connection.execute(update(samples).where(samples.c.id == name).values(used_at=now))
    if new.samples:
        connection.execute(_INSERT_USES, [{"mesh_id": new.id, "samples_id": name} for name in new.samples])
