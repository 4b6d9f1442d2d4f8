"""SQL of retention: finished meshes expire, so do samples that no mesh uses, and later the record that they existed.

Every transaction is short, so that a sweep does not delay the service, and skips rows that another service is sweeping.
"""

from collections.abc import Callable, Iterable, Sequence

from sqlalchemy import Connection, delete, func, select, update

from equimesh_service.store.database import Database, insert_new
from equimesh_service.store.mesh_rows import delete_ended, delete_meshes, find_unnamed, note_removals, remove_unused
from equimesh_service.store.schema import mesh_samples, meshes, removals, retired, samples, samples_keys

# The most rows that one transaction removes.
_MAX_REMOVED_AT_ONCE = 20
# How long the removal of a file is on record: far longer than between the sealing of a file and the row that names it.
_MAX_SEALED_SECONDS = 86_400.0


class RetentionStore:
    """Meshes and samples that expire, and the record of those that have expired."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._clock = clock

    def retire_meshes(self, age: float, remove_file: Callable[[str], None]) -> int:
        """Remove some of the meshes that were finished more than ``age`` seconds ago; returns their number."""
        latest = self._clock() - age
        late = meshes.c.finished_at < latest, func.coalesce(meshes.c.kept_from, 0.0) < latest
        query = select(meshes.c.id, meshes.c.key_id).where(*late)
        query = query.order_by(meshes.c.finished_at).limit(_MAX_REMOVED_AT_ONCE).with_for_update(skip_locked=True)
        with self._database.read() as connection:
            if connection.execute(query.with_only_columns(meshes.c.id).limit(1)).first() is None:
                return 0
        with self._database.write() as connection:
            rows = connection.execute(query).all()
            deleted = delete_meshes(connection, (row.id for row in rows), self._clock())
            for row in rows:
                self._note(connection, row.id, row.key_id)
        with self._database.write() as connection:
            for sequence_id, key_id in delete_ended(connection):
                self._note(connection, sequence_id, key_id)
        remove_unused(self._database, deleted.files, remove_file)
        return len(rows)

    def retire_samples(self, age: float, remove_file: Callable[[str], None]) -> int:
        """Remove some of the samples that were last used more than ``age`` seconds ago, and that no mesh uses."""
        late = samples.c.used_at < self._clock() - age
        unused = ~select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples.c.id).exists()
        query = select(samples.c.id, samples.c.sha256).where(late, unused).order_by(samples.c.used_at)
        query = query.limit(_MAX_REMOVED_AT_ONCE).with_for_update(skip_locked=True)
        with self._database.read() as connection:
            if connection.execute(query.with_only_columns(samples.c.id).limit(1)).first() is None:
                return 0
        held: set[str] = set()
        with self._database.write() as connection:
            for row in connection.execute(query).all():
                # Checked again under the lock: a mesh may have begun to use them.
                if connection.execute(select(samples.c.id).where(samples.c.id == row.id, late, unused)).first() is None:
                    continue
                owners = connection.execute(select(samples_keys.c.key_id).where(samples_keys.c.samples_id == row.id))
                for key_id in owners.scalars().all():
                    self._note(connection, row.id, key_id)
                connection.execute(delete(samples_keys).where(samples_keys.c.samples_id == row.id))
                connection.execute(delete(samples).where(samples.c.id == row.id))
                held.add(row.sha256)
            note_removals(connection, held, self._clock())
        remove_unused(self._database, held, remove_file)
        return len(held)

    def forget(self, age: float) -> int:
        """Drop the records of removals more than ``age`` seconds ago; returns their number."""
        with self._database.write() as connection:
            connection.execute(delete(removals).where(removals.c.noted_at < self._clock() - _MAX_SEALED_SECONDS))
            return connection.execute(delete(retired).where(retired.c.retired_at < self._clock() - age)).rowcount

    def has_removed(self, name: str, key_id: str | None) -> bool:
        """Whether a mesh, samples or a sequence with this id have expired. ``key_id`` None looks at all keys."""
        query = select(retired.c.id).where(retired.c.id == name)
        if key_id is not None:
            query = query.where(retired.c.key_id == key_id)
        with self._database.read() as connection:
            return connection.execute(query.limit(1)).first() is not None

    def find_unnamed(self, files: Iterable[str]) -> set[str]:
        """The names of ``files`` that are in no row."""
        with self._database.read() as connection:
            return find_unnamed(connection, files)

    def remove_unnamed(self, files: Sequence[str], remove_file: Callable[[str], None]) -> None:
        """Remove files that no row names; others stay."""
        with self._database.write() as connection:
            note_removals(connection, files, self._clock())
        remove_unused(self._database, files, remove_file)

    def _note(self, connection: Connection, name: str, key_id: str) -> None:
        row = {"id": name, "key_id": key_id, "retired_at": self._clock()}
        if not insert_new(connection, retired, row):  # samples that were uploaded again, and have expired again
            here = (retired.c.id == name, retired.c.key_id == key_id)
            connection.execute(update(retired).where(*here).values(retired_at=row["retired_at"]))
