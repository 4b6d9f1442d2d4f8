"""SQL of uploaded samples: equal samples are stored once, and each key sees those that it has uploaded."""

from collections.abc import Callable

from sqlalchemy import ColumnElement, Connection, Select, bindparam, delete, select

from equimesh_service.files.port import Publish, Removed, publish_nothing
from equimesh_service.store.blobs import insert_blob
from equimesh_service.store.database import Database, insert_new, lock
from equimesh_service.store.mesh_rows import note_removals, removal_lookup, remove_unused
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.rows import QUEUED, RUNNING, NewSamples, SamplesRow
from equimesh_service.store.schema import mesh_samples, meshes, retired, samples, samples_keys

# Statements are built once, since building them takes longer than executing them.
_STAY = select(samples.c.id).where(samples.c.id == bindparam("samples")).with_for_update(read=True, key_share=True)
_UNRETIRE = Prepared(delete(retired).where(retired.c.id == bindparam("samples"), retired.c.key_id == bindparam("key")))


class SamplesStore:
    """Samples of functions, stored once under an id that is a hash of their content.

    ``key_id`` is the API key of the caller; None stands for all keys.
    """

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._clock = clock

    def add(
        self, row: SamplesRow, publish: Publish = publish_nothing, *, key_id: str = "", durable: bool = True
    ) -> bool:
        """Store samples, and let the key see them; False when it sees them already.

        They need not be ``durable`` when the mesh that comes with them is.
        """
        with self._database.write(durable=durable) as connection:
            return insert_samples(connection, row, publish, key_id=key_id, now=self._clock())

    def keep(self, sent: NewSamples, key_id: str = "") -> None:
        """Store samples that are a small file with its bytes; the mesh that comes with them is durable."""

        def publish(_: Removed) -> None:
            insert_blob(self._database, sent.row.sha256, sent.archive)

        self.add(sent.row, publish, key_id=key_id, durable=False)

    def get(self, samples_id: str, key_id: str | None = None) -> SamplesRow | None:
        """The samples with this id; None also when the key has not sent them."""
        with self._database.read() as connection:
            row = connection.execute(_of(samples_id, key_id)).first()
        return None if row is None else SamplesRow(**row._mapping)

    def delete(self, samples_id: str, remove_file: Callable[[str], None], key_id: str | None = None) -> bool | None:
        """Delete samples for a key, and for good when no other key has uploaded them.

        Returns None when there are none, and False when an unfinished mesh needs them.
        """
        with self._database.write() as connection:
            here = samples.c.id == samples_id
            sha256 = connection.execute(select(samples.c.sha256).where(here)).scalar()
            if sha256 is None:
                return None
            lock(connection, [sha256])  # against uploads; the lock of the row is against meshes that need it
            connection.execute(select(samples.c.id).where(here).with_for_update())
            if connection.execute(_of(samples_id, key_id)).first() is None:
                return None
            owned = samples_keys.c.samples_id == samples_id
            others = select(samples_keys.c.key_id).where(owned, samples_keys.c.key_id != key_id)
            shared = key_id is not None and connection.execute(others.limit(1)).first() is not None
            query = select_needing(samples_id)
            if connection.execute(query.where(meshes.c.key_id == key_id) if shared else query).first() is not None:
                return False
            connection.execute(delete(samples_keys).where(owned, *_key_is(key_id)))
            if not shared:
                connection.execute(delete(samples).where(here))
                note_removals(connection, [sha256], self._clock())
        remove_unused(self._database, () if shared else (sha256,), remove_file)
        return True


def insert_samples(connection: Connection, row: SamplesRow, publish: Publish, *, key_id: str, now: float) -> bool:
    """Insert samples, and let the key see them; False when it sees them already."""
    lock(connection, [row.sha256])
    stored = {**vars(row), "used_at": now}
    new = insert_new(connection, samples, stored)
    if not new and connection.execute(_STAY, {"samples": row.id}).first() is None:
        new = insert_new(connection, samples, stored)  # they have just been deleted
    if new:
        publish(removal_lookup(connection))
    _UNRETIRE.execute(connection, {"samples": row.id, "key": key_id})
    owned = {"samples_id": row.id, "key_id": key_id, "created_at": row.created_at}
    return insert_new(connection, samples_keys, owned)


def select_needing(samples_id: str) -> Select[tuple[str]]:
    """The query for unfinished meshes that need samples."""
    uses = select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples_id)
    return select(meshes.c.id).where(meshes.c.id.in_(uses), meshes.c.status.in_((QUEUED, RUNNING))).limit(1)


def _of(samples_id: str, key_id: str | None) -> Select[tuple[object, ...]]:
    """The query for samples as a key sees them; `created_at` is the time of the key's own upload."""
    names = SamplesRow.__dataclass_fields__
    if key_id is None:
        return select(*(samples.c[name] for name in names)).where(samples.c.id == samples_id)
    columns = [(samples_keys if name == "created_at" else samples).c[name] for name in names]
    joined = samples.join(samples_keys, samples_keys.c.samples_id == samples.c.id)
    return select(*columns).select_from(joined).where(samples.c.id == samples_id, samples_keys.c.key_id == key_id)


def _key_is(key_id: str | None) -> list[ColumnElement[bool]]:
    return [] if key_id is None else [samples_keys.c.key_id == key_id]
