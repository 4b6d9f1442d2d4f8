"""SQL that deletes meshes with all that belongs to them alone.

Transactions that lock several things do so in one order, so that no two wait for each other: a sequence, its meshes,
samples, files; of one kind by their ids. Who holds a mesh therefore never asks for its sequence: that is looked at in a
transaction after the one that deletes the mesh.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import Connection, delete, select

from equimesh_service.store.artifacts import note_removals
from equimesh_service.store.rows import NODAL
from equimesh_service.store.schema import (
    artifacts,
    events,
    idempotency,
    mesh_samples,
    meshes,
    samples,
    samples_keys,
    sequences,
    steps,
)


@dataclass(frozen=True, kw_only=True)
class Deleted:
    """Meshes that were deleted, their files, for ``remove_unused``, and their sequences, for :func:`delete_ended`."""

    meshes: set[str]
    files: set[str]
    sequences: set[str]


def lock_meshes(connection: Connection, names: Iterable[str]) -> list[str]:
    """Lock meshes, so that no worker gives them a file from now on; returns those that are there."""
    query = select(meshes.c.id).where(meshes.c.id.in_(set(names))).order_by(meshes.c.id).with_for_update()
    return list(connection.execute(query).scalars())


def delete_meshes(connection: Connection, names: Iterable[str], now: float) -> Deleted:
    """Delete the rows of meshes, and note that their files may be removed.

    u at the nodes of an earlier mesh, which a step came with, goes with the last mesh that was made of it.
    """
    found = lock_meshes(connection, names)
    held = set(connection.execute(select(artifacts.c.sha256).where(artifacts.c.mesh_id.in_(found))).scalars())
    used = connection.execute(select(mesh_samples.c.samples_id).where(mesh_samples.c.mesh_id.in_(found))).scalars()
    nodal = {name for name in used if name.startswith(NODAL)}
    moved = set(connection.execute(select(steps.c.sequence_id).where(steps.c.mesh_id.in_(found))).scalars())
    for table in (events, artifacts, idempotency, mesh_samples, steps):
        connection.execute(delete(table).where(table.c.mesh_id.in_(found)))
    connection.execute(delete(meshes).where(meshes.c.id.in_(found)))
    held |= _delete_unused(connection, nodal)
    note_removals(connection, held, now)
    return Deleted(meshes=set(found), files=held, sequences=moved)


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
    unused = ~select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples.c.id).exists()
    query = select(samples.c.id, samples.c.sha256).where(samples.c.id.in_(set(names)), unused).order_by(samples.c.id)
    if not connection.execute(query.with_for_update()).all():
        return set()
    # Looked at again, now that they are locked: a mesh may have begun to use them.
    found = {row.id: row.sha256 for row in connection.execute(query)}
    connection.execute(delete(samples_keys).where(samples_keys.c.samples_id.in_(found.keys())))
    connection.execute(delete(samples).where(samples.c.id.in_(found.keys())))
    return set(found.values())
