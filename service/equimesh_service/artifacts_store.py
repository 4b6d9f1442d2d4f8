"""SQL of the files that rows name: shared by their content, removed after the last row that names them.

Rows go first, and the file after they are gone for good: a crash in between leaves a file that no row names, which
:mod:`equimesh_service.retention` finds, and never a row without its file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from sqlalchemy import Connection, bindparam, delete, insert, select

from equimesh_service.database import Database, lock
from equimesh_service.rows import Artifact
from equimesh_service.schema import artifacts, samples

# Built once: that takes longer than to execute them.
_REMOVE = delete(artifacts).where(artifacts.c.mesh_id == bindparam("mesh"), artifacts.c.name == bindparam("file"))
_INSERT = insert(artifacts)


def insert_artifacts(connection: Connection, mesh_id: str, files: Sequence[Artifact]) -> None:
    """Give a mesh files under their names, in place of older ones; nobody removes them until the end."""
    lock(connection, (file.sha256 for file in files))
    for file in files:
        connection.execute(_REMOVE, {"mesh": mesh_id, "file": file.name})
        connection.execute(_INSERT, {"mesh_id": mesh_id, **vars(file)})


def remove_unused(database: Database, held: Iterable[str], remove_file: Callable[[str], None]) -> None:
    """Give those files ``held`` that no row names any more to ``remove_file``.

    Inside a transaction: no row that names the file can be added between the look and the removal.
    """
    known = sorted(set(held))
    if not known:
        return
    with database.write() as connection:
        lock(connection, known)
        left = unnamed(connection, known)
        for sha256 in known:
            if sha256 in left:
                remove_file(sha256)


def unnamed(connection: Connection, held: Iterable[str]) -> set[str]:
    """Those files ``held`` that no row names."""
    known = set(held)
    in_artifacts = select(artifacts.c.sha256).where(artifacts.c.sha256.in_(known))
    in_samples = select(samples.c.sha256).where(samples.c.sha256.in_(known))
    return known.difference(connection.execute(in_artifacts).scalars(), connection.execute(in_samples).scalars())
