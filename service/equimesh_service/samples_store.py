"""SQL of samples that were uploaded."""

from __future__ import annotations

from collections.abc import Callable

from sqlalchemy import delete, insert, or_, select
from sqlalchemy.exc import IntegrityError

from equimesh_service.artifacts_store import remove_unused
from equimesh_service.database import Database
from equimesh_service.rows import QUEUED, RUNNING, SamplesRow
from equimesh_service.schema import mesh_samples, meshes, samples

_SHOWN = [samples.c[name] for name in SamplesRow.__dataclass_fields__]


def _nothing() -> None:
    pass


class SamplesStore:
    """Samples of functions, stored once under the id that their content gives them."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._read, self._write = database.read, database.write
        self._clock = clock

    def add(self, row: SamplesRow, publish: Callable[[], None] = _nothing) -> bool:
        """Keep samples; False when they were there already."""
        try:
            with self._write() as connection:
                connection.execute(insert(samples).values(vars(row)))
                publish()
        except IntegrityError:
            return False
        return True

    def get(self, samples_id: str) -> SamplesRow | None:
        """The samples with this id."""
        with self._read() as connection:
            row = connection.execute(select(*_SHOWN).where(samples.c.id == samples_id)).first()
        return None if row is None else SamplesRow(**row._mapping)

    def delete(self, samples_id: str, remove_file: Callable[[str], None]) -> bool | None:
        """Delete samples. None when there are none, False when a mesh that is not finished needs them."""
        with self._write() as connection:
            sha256 = connection.execute(select(samples.c.sha256).where(samples.c.id == samples_id)).scalar()
            if sha256 is None:
                return None
            open_meshes = meshes.c.status.in_((QUEUED, RUNNING))
            uses = select(mesh_samples.c.mesh_id).where(mesh_samples.c.samples_id == samples_id)
            needs = or_(meshes.c.samples_id == samples_id, meshes.c.id.in_(uses))
            query = select(meshes.c.id).where(needs, open_meshes).limit(1)
            if connection.execute(query).first() is not None:
                return False
            connection.execute(delete(samples).where(samples.c.id == samples_id))
            remove_unused(connection, {sha256}, remove_file)
            return True
