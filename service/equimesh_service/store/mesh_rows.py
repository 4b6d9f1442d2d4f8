"""SQL that inserts and deletes meshes, with their events and the files that they name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, bindparam, delete, insert, select, update

from equimesh_service.errors import SamplesGoneError
from equimesh_service.files.port import Removed
from equimesh_service.store.database import Database, insert_new, lock, to_json
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.rows import NODAL, QUEUED, RUNNING, SUCCEEDED, Artifact, Lease, NewMesh, Outcome
from equimesh_service.store.schema import (
    artifacts,
    blobs,
    events,
    mesh_samples,
    meshes,
    removals,
    samples,
    sequences,
    steps,
)

# Statements are built once, since building them takes longer than executing them.
_REMOVE = Prepared(
    delete(artifacts).where(artifacts.c.mesh_id == bindparam("mesh"), artifacts.c.name == bindparam("file"))
)
_INSERT = Prepared(insert(artifacts))
# The most small files that are removed in one transaction.
_MOST_TOGETHER = 16
_FIND_REMOVAL = select(removals.c.sha256).where(removals.c.sha256 == bindparam("file")).limit(1)
_HAS_BLOB = Prepared(select(blobs.c.size).where(blobs.c.sha256 == bindparam("file")))
_NAMING = [
    Prepared(select(table.c.sha256).where(table.c.sha256 == bindparam("file")).limit(1))
    for table in (artifacts, samples)
]


def insert_artifacts(connection: Connection, mesh_id: str, files: Sequence[Artifact]) -> None:
    """Give a mesh files, in place of older ones of the same names; none is removed before the transaction ends."""
    lock(connection, (file.sha256 for file in files))
    for file in files:
        _REMOVE.execute(connection, {"mesh": mesh_id, "file": file.name})
    add_artifacts(connection, mesh_id, files)


def add_artifacts(connection: Connection, mesh_id: str, files: Sequence[Artifact]) -> None:
    """Give a new mesh its files, which are locked."""
    if files:
        _INSERT.execute(connection, *({"mesh_id": mesh_id, **vars(file)} for file in files))


def note_removals(connection: Connection, files: Iterable[str], now: float) -> None:
    """Note that files may be removed as soon as this transaction is committed."""
    for sha256 in sorted(set(files)):
        insert_new(connection, removals, {"sha256": sha256, "noted_at": now})


def removal_lookup(connection: Connection) -> Removed:
    """A function that tells whether the removal of a file was noted, for a transaction that holds the file's lock."""
    return lambda sha256: connection.execute(_FIND_REMOVAL, {"file": sha256}).first() is not None


def remove_unused(database: Database, files: Iterable[str], remove_file: Callable[[str], None]) -> None:
    """Call ``remove_file`` for all files that no row names any more; their removal has been noted.

    No row that names a file can be added between the check and the removal. Some small files, which are rows, go in one
    transaction. Each other file has its own, since the storage may be slow. What a crash undoes is swept up later.
    """
    left = sorted(set(files))
    with database.read() as connection:
        small = [name for name in left if _HAS_BLOB.execute(connection, {"file": name}).first() is not None]
    together = [small[first : first + _MOST_TOGETHER] for first in range(0, len(small), _MOST_TOGETHER)]
    for names in [*together, *([name] for name in left if name not in small)]:
        with database.write(durable=False) as connection:
            lock(connection, names)
            for sha256 in sorted(find_unnamed(connection, names)):
                remove_file(sha256)


def find_unnamed(connection: Connection, files: Iterable[str]) -> set[str]:
    """The names of ``files`` that are in no row."""

    def is_named(file: str) -> bool:
        return any(query.execute(connection, {"file": file}).first() is not None for query in _NAMING)

    return {file for file in files if not is_named(file)}


# How exactly the time of the last use of samples is stored.
_USED_AT_PRECISION_SECONDS = 3600.0
_INSERT_MESH = Prepared(insert(meshes).inline())
_INSERT_USES = Prepared(insert(mesh_samples))
_INSERT_EVENTS = Prepared(insert(events))
_USED_AT = Prepared(
    select(samples.c.used_at).where(samples.c.id == bindparam("name")).with_for_update(read=True, key_share=True)
)
# The values of columns that a new mesh need not name.
_DEFAULTS: dict[str, Any] = {column.name: column.default for column in meshes.columns}
_USUAL = {name: usual.arg for name, usual in _DEFAULTS.items() if usual is not None}


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
        **_USUAL,
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
    _INSERT_MESH.execute(connection, row)
    rows = [
        {"mesh_id": new.id, "number": number, "time": now, "kind": kind, "data": dict(data)}
        for number, (kind, data) in enumerate(story, start=1)
    ]
    _INSERT_EVENTS.execute(connection, *rows)


def use_samples(connection: Connection, new: NewMesh, now: float) -> None:
    """Note that a mesh which was just inserted uses its samples, and the time of their use.

    They are locked, so that they are not deleted before the transaction ends.
    """
    for name in sorted(new.samples):
        used_at = _USED_AT.execute(connection, {"name": name}).scalar()
        if used_at is None:
            raise SamplesGoneError(name)
        if used_at < now - _USED_AT_PRECISION_SECONDS:
            connection.execute(update(samples).where(samples.c.id == name).values(used_at=now))
    if new.samples:
        _INSERT_USES.execute(connection, *({"mesh_id": new.id, "samples_id": name} for name in new.samples))


@dataclass(frozen=True, kw_only=True)
class Deletion:
    """The meshes that were deleted, their files for ``remove_unused``, and their sequences for :func:`delete_ended`."""

    meshes: set[str]
    files: set[str]
    sequences: set[str]


# One mesh at a time: a step deletes one, and an index finds it.
_OF_MESH: Any = bindparam("mesh")
_LOCK_MESH = Prepared(select(meshes.c.id).where(meshes.c.id == _OF_MESH).with_for_update())
_FILES = Prepared(select(artifacts.c.sha256).where(artifacts.c.mesh_id == _OF_MESH))
_USED = Prepared(select(mesh_samples.c.samples_id).where(mesh_samples.c.mesh_id == _OF_MESH))
_SEQUENCE = Prepared(select(steps.c.sequence_id).where(steps.c.mesh_id == _OF_MESH))
_DELETE_MESH = Prepared(delete(meshes).where(meshes.c.id == _OF_MESH))
_IS_UNUSED = ~select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples.c.id).exists()
_UNUSED = select(samples.c.sha256).where(samples.c.id == bindparam("name"), _IS_UNUSED)
_FIND_UNUSED, _LOCK_UNUSED = Prepared(_UNUSED), Prepared(_UNUSED.with_for_update())
_DELETE_SAMPLES = Prepared(delete(samples).where(samples.c.id == bindparam("name")))


def lock_meshes(connection: Connection, names: Iterable[str]) -> list[str]:
    """Lock meshes, so that no worker gives them a file from now on; returns those that are there."""
    return [name for name in sorted(set(names)) if _LOCK_MESH.execute(connection, {"mesh": name}).first() is not None]


def delete_meshes(connection: Connection, names: Iterable[str], now: float) -> Deletion:
    """Delete meshes with all rows that refer to them, and note that their files may be removed.

    u at the nodes of an earlier mesh, which a step came with, goes with the last mesh that was made of it.
    """
    found = lock_meshes(connection, names)
    held, nodal, moved = set[str](), set[str](), set[str]()
    for name in found:
        here = {"mesh": name}
        held.update(_FILES.execute(connection, here).scalars())
        nodal.update(used for used in _USED.execute(connection, here).scalars() if used.startswith(NODAL))
        moved.update(_SEQUENCE.execute(connection, here).scalars())
        _DELETE_MESH.execute(connection, here)
    held |= _delete_unused(connection, nodal)
    note_removals(connection, held, now)
    return Deletion(meshes=set(found), files=held, sequences=moved)


def delete_ended(connection: Connection, names: Iterable[str] | None = None) -> list[tuple[str, str]]:
    """Delete those sequences, of all or of some, whose last mesh is gone; returns the id and the key of each."""
    ended = ~select(steps.c.mesh_id).where(steps.c.sequence_id == sequences.c.id).exists()
    query = select(sequences.c.id).where(ended).order_by(sequences.c.id).with_for_update()
    if names is not None:
        query = query.where(sequences.c.id.in_(set(names)))
    found = connection.execute(query).scalars().all()
    # Looked at again, now that they are locked.
    gone = delete(sequences).where(sequences.c.id.in_(found), ended).returning(sequences.c.id, sequences.c.key_id)
    return [(str(row.id), str(row.key_id)) for row in connection.execute(gone)]


def _delete_unused(connection: Connection, names: Iterable[str]) -> set[str]:
    """Delete those samples that no mesh uses any more; returns their files."""
    files = set[str]()
    for name in sorted(set(names)):
        here = {"name": name}
        if _LOCK_UNUSED.execute(connection, here).first() is None:
            continue
        # Looked at again, now that they are locked: a mesh may have begun to use them.
        found = _FIND_UNUSED.execute(connection, here).scalar()
        if found is not None:
            _DELETE_SAMPLES.execute(connection, here)
            files.add(found)
    return files
