"""SQL of the files that rows name: shared by their content, removed after the last row that names them.

Rows go first, and the file after they are gone for good: a crash in between leaves a file that no row names, which
:mod:`equimesh_service.upkeep.retention` finds, and never a row without its file.

A removal is noted, and committed, before it happens. Naming a file for the first time and removing it both hold its
lock: when the first finds no note, the second has not begun, and will find the file named.
"""

from collections.abc import Callable, Iterable, Sequence

from sqlalchemy import Connection, bindparam, delete, insert, select

from equimesh_service.files.port import Removed
from equimesh_service.store.database import Database, insert_new, lock
from equimesh_service.store.rows import Artifact
from equimesh_service.store.schema import artifacts, removals, samples

# Built once: that takes longer than to execute them.
_REMOVE = delete(artifacts).where(artifacts.c.mesh_id == bindparam("mesh"), artifacts.c.name == bindparam("file"))
_INSERT = insert(artifacts)
_FIND_REMOVAL = select(removals.c.sha256).where(removals.c.sha256 == bindparam("file")).limit(1)


def insert_artifacts(connection: Connection, mesh_id: str, files: Sequence[Artifact]) -> None:
    """Give a mesh files under their names, in place of older ones; none is removed before the transaction ends."""
    lock(connection, (file.sha256 for file in files))
    for file in files:
        connection.execute(_REMOVE, {"mesh": mesh_id, "file": file.name})
        connection.execute(_INSERT, {"mesh_id": mesh_id, **vars(file)})


def note_removals(connection: Connection, held: Iterable[str], now: float) -> None:
    """Note that files may be removed as soon as this transaction is committed."""
    for sha256 in sorted(set(held)):
        insert_new(connection, removals, {"sha256": sha256, "noted_at": now})


def removal_lookup(connection: Connection) -> Removed:
    """What tells whether the removal of a file was noted, in a transaction that holds the lock of the file."""
    return lambda sha256: connection.execute(_FIND_REMOVAL, {"file": sha256}).first() is not None


def remove_unused(database: Database, held: Iterable[str], remove_file: Callable[[str], None]) -> None:
    """Give those files ``held`` that no row names any more to ``remove_file``; their removal has been noted.

    Inside a transaction, of its own for each, since storage may be far away: no row that names the file can be added
    between the look and the removal.
    """
    for sha256 in sorted(set(held)):
        with database.write() as connection:
            lock(connection, [sha256])
            if find_unnamed(connection, [sha256]):
                remove_file(sha256)


def find_unnamed(connection: Connection, held: Iterable[str]) -> set[str]:
    """Those files ``held`` that no row names."""
    known = set(held)
    in_artifacts = select(artifacts.c.sha256).where(artifacts.c.sha256.in_(known))
    in_samples = select(samples.c.sha256).where(samples.c.sha256.in_(known))
    return known.difference(connection.execute(in_artifacts).scalars(), connection.execute(in_samples).scalars())
