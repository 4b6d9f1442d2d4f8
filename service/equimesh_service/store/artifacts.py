"""SQL of the files that rows name: equal files are stored once, and removed after the last row that names them.

Rows are deleted and committed first, then the file. A crash in between leaves a file that no row names, which
:mod:`equimesh_service.upkeep.retention` finds, and never a row without its file.

A removal is noted, and committed, before it happens. To name a file for the first time and to remove it, a transaction
holds the lock of the file. If the first finds no note, the second has not begun, and will see that the file is named.
"""

from collections.abc import Callable, Iterable, Sequence

from sqlalchemy import Connection, bindparam, delete, insert, select

from equimesh_service.files.port import Removed
from equimesh_service.store.database import Database, insert_new, lock
from equimesh_service.store.rows import Artifact
from equimesh_service.store.schema import artifacts, removals, samples

# Statements are built once, since building them takes longer than executing them.
_REMOVE = delete(artifacts).where(artifacts.c.mesh_id == bindparam("mesh"), artifacts.c.name == bindparam("file"))
_INSERT = insert(artifacts)
_FIND_REMOVAL = select(removals.c.sha256).where(removals.c.sha256 == bindparam("file")).limit(1)


def insert_artifacts(connection: Connection, mesh_id: str, files: Sequence[Artifact]) -> None:
    """Give a mesh files, in place of older ones of the same names; none is removed before the transaction ends."""
    lock(connection, (file.sha256 for file in files))
    for file in files:
        connection.execute(_REMOVE, {"mesh": mesh_id, "file": file.name})
        connection.execute(_INSERT, {"mesh_id": mesh_id, **vars(file)})


def note_removals(connection: Connection, files: Iterable[str], now: float) -> None:
    """Note that files may be removed as soon as this transaction is committed."""
    for sha256 in sorted(set(files)):
        insert_new(connection, removals, {"sha256": sha256, "noted_at": now})


def removal_lookup(connection: Connection) -> Removed:
    """A function that tells whether the removal of a file was noted, for a transaction that holds the file's lock."""
    return lambda sha256: connection.execute(_FIND_REMOVAL, {"file": sha256}).first() is not None


def remove_unused(database: Database, files: Iterable[str], remove_file: Callable[[str], None]) -> None:
    """Call ``remove_file`` for those of the files that no row names any more; their removal has been noted.

    Each in a transaction of its own, since the storage may be slow: no row that names the file can be added between the
    check and the removal.
    """
    for sha256 in sorted(set(files)):
        with database.write() as connection:
            lock(connection, [sha256])
            if find_unnamed(connection, [sha256]):
                remove_file(sha256)


def find_unnamed(connection: Connection, files: Iterable[str]) -> set[str]:
    """The names of ``files`` that are in no row."""
    known = set(files)
    in_artifacts = select(artifacts.c.sha256).where(artifacts.c.sha256.in_(known))
    in_samples = select(samples.c.sha256).where(samples.c.sha256.in_(known))
    return known.difference(connection.execute(in_artifacts).scalars(), connection.execute(in_samples).scalars())
