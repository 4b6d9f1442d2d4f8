"""SQL of sequences: moving meshes, each step of which is a mesh like any other.

The state of a sequence is that of its last step. A failed step does not count: the next one takes its number.
"""

from collections.abc import Callable
from typing import Any

from sqlalchemy import Connection, delete, insert, select, tuple_, update

from equimesh_service.errors import StepTakenError
from equimesh_service.store.artifacts import insert_artifacts, removal_lookup, remove_unused
from equimesh_service.store.database import Database
from equimesh_service.store.deletion import delete_meshes, lock_meshes
from equimesh_service.store.rows import CANCELED, FAILED, SUCCEEDED, NewMesh, NewStep, SequenceRow
from equimesh_service.store.schema import meshes, sequences, steps

_SHOWN = [sequences.c[name] for name in ("id", "key_id", "keep", "created_at", "used_at")]


class SequencesStore:
    """Sequences and their steps."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._clock = clock
        self._read = database.read

    def get(self, sequence_id: str) -> SequenceRow | None:
        """The sequence with this id, at its last step that has not failed."""
        joined = sequences.join(steps, steps.c.sequence_id == sequences.c.id).join(
            meshes, meshes.c.id == steps.c.mesh_id
        )
        query = (
            select(*_SHOWN, steps.c.number, steps.c.mesh_id, meshes.c.status)
            .select_from(joined)
            .where(sequences.c.id == sequence_id)
            .order_by(steps.c.number.desc())
        )
        with self._read() as connection:
            rows = connection.execute(query).all()
        if not rows:
            return None
        return SequenceRow(**next((row for row in rows if row.status not in (FAILED, CANCELED)), rows[0])._mapping)

    def page(
        self, *, key_id: str | None = None, before: tuple[float, str] | None = None, limit: int = 50
    ) -> list[SequenceRow]:
        """Sequences at their last steps, newest first, after the position ``before``; those of one key, unless None."""
        order = (sequences.c.created_at, sequences.c.id)
        has_steps = select(steps.c.mesh_id).where(steps.c.sequence_id == sequences.c.id).exists()
        query = select(*_SHOWN).where(has_steps).order_by(*(column.desc() for column in order)).limit(limit)
        if key_id is not None:
            query = query.where(sequences.c.key_id == key_id)
        if before is not None:
            query = query.where(tuple_(*order) < before)
        with self._read() as connection:
            found = connection.execute(query).all()
            joined = steps.join(meshes, meshes.c.id == steps.c.mesh_id)
            names = [row.id for row in found]
            taken = (
                select(steps.c.sequence_id, steps.c.number, steps.c.mesh_id, meshes.c.status)
                .select_from(joined)
                .where(steps.c.sequence_id.in_(names))
                .order_by(steps.c.number)
            )
            current: dict[str, Any] = {}
            for row in connection.execute(taken):
                if row.status not in (FAILED, CANCELED) or row.sequence_id not in current:
                    current[row.sequence_id] = row
        return [
            SequenceRow(**row._mapping, number=step.number, mesh_id=step.mesh_id, status=step.status)
            for row in found
            if (step := current.get(row.id)) is not None
        ]

    def mesh_of(self, sequence_id: str, number: int) -> str | None:
        """The mesh of a step."""
        query = select(steps.c.mesh_id).where(steps.c.sequence_id == sequence_id, steps.c.number == number)
        with self._read() as connection:
            found = connection.execute(query).scalar()
        return None if found is None else str(found)

    def step_of(self, mesh_id: str) -> tuple[str, int] | None:
        """The sequence of a mesh, and the number of its step."""
        query = select(steps.c.sequence_id, steps.c.number).where(steps.c.mesh_id == mesh_id)
        with self._read() as connection:
            row = connection.execute(query).first()
        return None if row is None else (str(row.sequence_id), int(row.number))

    def settings_of(self, mesh_id: str) -> dict[str, Any]:
        """The settings of the step that a mesh is; empty for one without."""
        with self._read() as connection:
            found = connection.execute(select(steps.c.settings).where(steps.c.mesh_id == mesh_id)).scalar()
        return dict(found or {})

    def meshes(self, sequence_id: str) -> list[str]:
        """The meshes of a sequence that are still kept."""
        query = select(steps.c.mesh_id).where(steps.c.sequence_id == sequence_id)
        with self._read() as connection:
            return [str(name) for name in connection.execute(query).scalars()]

    def delete(self, sequence_id: str, remove_file: Callable[[str], None]) -> bool:
        """Delete a sequence with all its meshes; False when there is none."""
        with self._database.write() as connection:
            here = sequences.c.id == sequence_id
            if connection.execute(select(sequences.c.id).where(here).with_for_update()).first() is None:
                return False
            made = connection.execute(select(steps.c.mesh_id).where(steps.c.sequence_id == sequence_id)).scalars()
            deleted = delete_meshes(connection, made, self._clock())
            connection.execute(delete(sequences).where(here))
        remove_unused(self._database, deleted.files, remove_file)
        return True


def take_turn(connection: Connection, step: NewStep, now: float) -> list[str]:
    """Begin the sequence, or check that its next step is this one, before anything else is locked.

    Returns the meshes that are no longer kept, locked. Raises :class:`StepTakenError` when another step has been taken,
    or the start of this one is gone.
    """
    if step.number == 0:
        begun = {"id": step.sequence_id, "key_id": step.key_id, "keep": step.keep, "created_at": now, "used_at": now}
        connection.execute(insert(sequences).values(begun))
        return []
    here = sequences.c.id == step.sequence_id
    if connection.execute(select(sequences.c.id).where(here).with_for_update()).first() is None:
        raise StepTakenError
    joined = steps.join(meshes, meshes.c.id == steps.c.mesh_id)
    query = select(steps.c.number, steps.c.mesh_id, meshes.c.status).select_from(joined)
    found = connection.execute(query.where(steps.c.sequence_id == step.sequence_id)).all()
    status = {int(row.number): str(row.status) for row in found}
    failed = status.get(step.number, FAILED) in (FAILED, CANCELED)
    if status.get(step.number - 1) != SUCCEEDED or max(status) > step.number or not failed:
        raise StepTakenError
    connection.execute(update(sequences).where(here).values(used_at=now))
    leaving = [row for row in found if row.number == step.number or row.number <= step.number - step.keep]
    return lock_meshes(connection, [str(row.mesh_id) for row in leaving])


def insert_step(connection: Connection, new: NewMesh, step: NewStep) -> None:
    """Insert the step of a mesh that has just been inserted, with the file of its fields."""
    row = {
        "mesh_id": new.id,
        "sequence_id": step.sequence_id,
        "number": step.number,
        "start": step.start,
        "fields": None if step.fields is None else step.fields.sha256,
        "settings": None if step.settings is None else dict(step.settings),
    }
    connection.execute(insert(steps).values(row))
    if step.fields is not None:
        insert_artifacts(connection, new.id, [step.fields])
        step.publish(removal_lookup(connection))
