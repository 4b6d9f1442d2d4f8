"""SQL that deletes meshes with all that belongs to them alone."""

from __future__ import annotations

from collections.abc import Iterable

from sqlalchemy import Connection, delete, select

from equimesh_service.rows import NODAL
from equimesh_service.schema import (
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


def delete_mesh(connection: Connection, mesh_id: str) -> set[str] | None:
    """Delete the rows of a mesh, and give its files, for ``remove_unused``; None when there is no such mesh.

    u at the nodes of an earlier mesh, which a step came with, goes with the last mesh that was made of it.
    """
    here = meshes.c.id == mesh_id
    # Locked, so that no worker gives it a file that is not seen here.
    if connection.execute(select(meshes.c.id).where(here).with_for_update()).first() is None:
        return None
    held = set(connection.execute(select(artifacts.c.sha256).where(artifacts.c.mesh_id == mesh_id)).scalars())
    used = select(mesh_samples.c.samples_id).where(mesh_samples.c.mesh_id == mesh_id)
    nodal = [name for name in connection.execute(used).scalars() if name.startswith(NODAL)]
    for table in (events, artifacts, idempotency, mesh_samples, steps):
        connection.execute(delete(table).where(table.c.mesh_id == mesh_id))
    connection.execute(delete(meshes).where(here))
    return held | _delete_unused(connection, nodal)


def delete_ended(connection: Connection) -> list[tuple[str, str]]:
    """Delete the sequences whose last mesh is gone; returns the id and the key of each."""
    ended = ~select(steps.c.mesh_id).where(steps.c.sequence_id == sequences.c.id).exists()
    query = select(sequences.c.id, sequences.c.key_id).where(ended)
    rows = [(str(row.id), str(row.key_id)) for row in connection.execute(query.with_for_update())]
    connection.execute(delete(sequences).where(sequences.c.id.in_([name for name, _ in rows]), ended))
    return rows


def _delete_unused(connection: Connection, names: Iterable[str]) -> set[str]:
    """Delete those samples that no mesh uses any more; returns their files."""
    held = set()
    for name in sorted(names):
        here = samples.c.id == name
        sha256 = connection.execute(select(samples.c.sha256).where(here).with_for_update()).scalar()
        # Looked for now that the samples are locked: a mesh may have begun to use them.
        uses = select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == name).limit(1)
        if sha256 is None or connection.execute(uses).first() is not None:
            continue
        connection.execute(delete(samples_keys).where(samples_keys.c.samples_id == name))
        connection.execute(delete(samples).where(here))
        held.add(sha256)
    return held
