"""SQL of meshes and of sequences: their specs, states, results, events and steps."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from sqlalchemy import Connection, Row, bindparam, delete, insert, select, tuple_, update
from sqlalchemy.exc import IntegrityError

from equimesh_service.errors import KeyReusedError, StepTakenError
from equimesh_service.files.port import Publish, publish_nothing
from equimesh_service.store.database import Database, lock
from equimesh_service.store.keys import Quota, take
from equimesh_service.store.mesh_rows import (
    add_artifacts,
    delete_ended,
    delete_meshes,
    insert_artifacts,
    insert_finished,
    insert_reused,
    insert_waiting,
    lock_meshes,
    removal_lookup,
    remove_unused,
    use_samples,
)
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.rows import (
    CANCELED,
    FAILED,
    FINISHED,
    SUCCEEDED,
    Artifact,
    EventRow,
    Followed,
    Lease,
    MeshInput,
    MeshRow,
    NewEntry,
    NewMesh,
    NewStep,
    Outcome,
    Position,
    SequenceRow,
)
from equimesh_service.store.samples import insert_samples
from equimesh_service.store.schema import (
    artifacts,
    events,
    idempotency,
    mesh_samples,
    meshes,
    samples,
    sequences,
    steps,
)

_SHOWN_SEQUENCES = [sequences.c[name] for name in ("id", "key_id", "keep", "created_at", "used_at")]
_LAST_STEP = (steps.c.number, steps.c.mesh_id, meshes.c.status, (meshes.c.n_xi * meshes.c.n_eta).label("points"))
_HERE = sequences.c.id == bindparam("sequence")
# Built once, since building them takes longer than executing them.
_SHOW_SEQUENCE = Prepared(
    select(*_SHOWN_SEQUENCES, *_LAST_STEP)
    .select_from(sequences.join(steps, steps.c.sequence_id == sequences.c.id))
    .join(meshes, meshes.c.id == steps.c.mesh_id)
    .where(_HERE)
    .order_by(steps.c.number.desc())
)
_LOCK_SEQUENCE = Prepared(select(sequences.c.id).where(_HERE).with_for_update())
_USE_SEQUENCE = Prepared(update(sequences).where(_HERE).values(used_at=bindparam("now")))
_TAKEN = Prepared(
    select(steps.c.number, steps.c.mesh_id, meshes.c.status)
    .select_from(steps.join(meshes, meshes.c.id == steps.c.mesh_id))
    .where(steps.c.sequence_id == bindparam("sequence"))
)
_INSERT_STEP = Prepared(insert(steps))
_FOLLOWED = (
    select(meshes.c.spec, meshes.c.result, artifacts.c.sha256, steps.c.settings)
    .select_from(meshes.join(artifacts).outerjoin(steps, steps.c.mesh_id == meshes.c.id))
    .where(meshes.c.id == bindparam("mesh"), artifacts.c.name == "mesh")
)
_SAMPLES_OF = Prepared(
    select(samples.c.id, samples.c.sha256)
    .select_from(mesh_samples.join(samples, samples.c.id == mesh_samples.c.samples_id))
    .where(mesh_samples.c.mesh_id == bindparam("mesh"))
)


class SequencesStore:
    """Sequences and their steps."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._clock = clock
        self._read = database.read

    def get(self, sequence_id: str) -> SequenceRow | None:
        """The sequence with this id, at its last step that has not failed."""
        with self._read() as connection:
            rows = _SHOW_SEQUENCE.execute(connection, {"sequence": sequence_id}).all()
        if not rows:
            return None
        return SequenceRow(**next((row for row in rows if row.status not in (FAILED, CANCELED)), rows[0])._asdict())

    def page(
        self, *, key_id: str | None = None, before: tuple[float, str] | None = None, limit: int = 50
    ) -> list[SequenceRow]:
        """Sequences at their last steps, newest first, after the position ``before``; of one key, unless None."""
        order = (sequences.c.created_at, sequences.c.id)
        has_steps = select(steps.c.mesh_id).where(steps.c.sequence_id == sequences.c.id).exists()
        query = select(*_SHOWN_SEQUENCES).where(has_steps).order_by(*(column.desc() for column in order)).limit(limit)
        if key_id is not None:
            query = query.where(sequences.c.key_id == key_id)
        if before is not None:
            query = query.where(tuple_(*order) < before)
        with self._read() as connection:
            found = connection.execute(query).all()
            joined = steps.join(meshes, meshes.c.id == steps.c.mesh_id)
            names = [row.id for row in found]
            taken = (
                select(steps.c.sequence_id, *_LAST_STEP)
                .select_from(joined)
                .where(steps.c.sequence_id.in_(names))
                .order_by(steps.c.number)
            )
            current: dict[str, Any] = {}
            for row in connection.execute(taken):
                if row.status not in (FAILED, CANCELED) or row.sequence_id not in current:
                    current[row.sequence_id] = row
        return [
            SequenceRow(
                **row._mapping, number=step.number, mesh_id=step.mesh_id, status=step.status, points=step.points
            )
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

    def followed(self, mesh_id: str) -> Followed | None:
        """What a step needs of the mesh that it follows; None when the mesh or its file is gone."""
        with self._read() as connection:
            row = connection.execute(_FOLLOWED, {"mesh": mesh_id}).first()
            held = {} if row is None else _samples_of(connection, mesh_id)
        if row is None:
            return None
        gains = ((row.result or {}).get("certificate") or {}).get("interpolation_gain") or {}
        spec = json.loads(row.spec)
        return Followed(spec=spec, file=row.sha256, samples=held, settings=row.settings or {}, gains=gains)

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
    here = {"sequence": step.sequence_id}
    if _LOCK_SEQUENCE.execute(connection, here).first() is None:
        raise StepTakenError
    found = _TAKEN.execute(connection, here).all()
    status = {int(row.number): str(row.status) for row in found}
    failed = status.get(step.number, FAILED) in (FAILED, CANCELED)
    if status.get(step.number - 1) != SUCCEEDED or max(status) > step.number or not failed:
        raise StepTakenError
    _USE_SEQUENCE.execute(connection, {**here, "now": now})
    leaving = [row for row in found if row.number == step.number or row.number <= step.number - step.keep]
    return lock_meshes(connection, [str(row.mesh_id) for row in leaving])


def insert_functions(connection: Connection, new: NewMesh, step: NewStep, now: float) -> None:
    """Insert the functions of a step, before the mesh that uses them."""
    files = [row.sha256 for row, _ in step.functions]
    lock(connection, files if step.fields is None else [*files, step.fields.sha256])
    for row, publish in step.functions:
        insert_samples(connection, row, publish, key_id=new.key_id, now=now)


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
    _INSERT_STEP.execute(connection, row)
    if step.fields is not None:
        add_artifacts(connection, new.id, [step.fields])
        step.publish(removal_lookup(connection))


# The most ids in one query.
_MAX_IDS_PER_QUERY = 500
_SHOWN = [meshes.c[name] for name in MeshRow.__dataclass_fields__]
# Built once, since building them takes longer than executing them.
_SHOW = select(*_SHOWN).where(meshes.c.id == bindparam("mesh"))
_EQUAL = (
    select(meshes.c.id, meshes.c.result)
    .where(meshes.c.fingerprint == bindparam("points"), meshes.c.key_id == bindparam("key"))
    .where(meshes.c.status == SUCCEEDED)
    .order_by(meshes.c.number)
    .limit(1)
)
_KNOWN_KEY = select(idempotency.c.mesh_id).where(
    idempotency.c.key_id == bindparam("key_id"), idempotency.c.key == bindparam("key")
)
_EQUAL_LOCKED = _EQUAL.with_for_update(read=True, key_share=True)


class MeshesStore:
    """Meshes, with their specs, events and artifacts."""

    def __init__(self, database: Database, clock: Callable[[], float]) -> None:
        self._database = database
        self._read, self._write = database.read, database.write
        self._clock = clock

    def add(
        self,
        new: NewMesh,
        *,
        key: str | None = None,
        fingerprint: str = "",
        quota: Quota | None = None,
        lease: Lease | None = None,
        step: NewStep | None = None,
    ) -> str:
        """Put a mesh into the queue and return its id; for a repeated ``key``, return the id of the earlier mesh.

        With ``lease`` the mesh does not wait: it is claimed at once, as its first attempt. As the ``step`` of a
        sequence it replaces meshes that are no longer kept.

        Raises :class:`KeyReusedError` when the key belongs to another ``fingerprint``,
        :class:`~equimesh_service.errors.SamplesGoneError` when the samples were deleted,
        :class:`~equimesh_service.errors.QuotaError` at a limit, and :class:`StepTakenError`.
        """
        held: set[str] = set()

        def put(connection: Connection) -> bool:
            if quota is not None:
                take(connection, new.key_id, new.points, quota)
            leaving = [] if step is None else take_turn(connection, step, self._clock())
            if step is not None:
                insert_functions(connection, new, step, self._clock())
            insert_waiting(connection, new, lease, self._clock())
            if step is not None:
                # After the insertion, since the mesh may use the samples of a failed step that is deleted here.
                held.update(delete_meshes(connection, leaving, self._clock()).files)
                insert_step(connection, new, step)
            return True

        added = self._once(new, key, fingerprint, put)
        assert added is not None
        if step is not None and added == new.id:
            self._database.when_committed(partial(remove_unused, self._database, held, step.discard))
        return added

    def add_finished(
        self, entry: NewEntry, outcome: Outcome, *, seconds: float, publish_samples: Publish = publish_nothing
    ) -> str:
        """Insert a mesh that was finished after ``seconds`` of work, with its samples and files, and return its id.

        For a repeated key, return the id of the earlier mesh. As a step it replaces meshes that are no longer kept.
        Raises :class:`KeyReusedError`, :class:`~equimesh_service.errors.SamplesGoneError` and :class:`StepTakenError`
        as :meth:`add`.
        """
        new, sent, step, now = entry.new, entry.samples, entry.step, self._clock()
        files = [file.sha256 for file in outcome.files]
        held: set[str] = set()

        def put(connection: Connection) -> bool:
            leaving = [] if step is None else take_turn(connection, step, now)
            if step is not None:
                insert_functions(connection, new, step, now)
            # The mesh first, then samples and files, as in all transactions: so no two wait for each other.
            insert_finished(connection, new, outcome, now, seconds)
            lock(connection, files if sent is None else [sent.row.sha256, *files])
            if sent is not None:
                insert_samples(connection, sent.row, publish_samples, key_id=new.key_id, now=now)
            use_samples(connection, new, now)
            if step is not None:
                held.update(delete_meshes(connection, leaving, now).files)
                insert_step(connection, new, step)
            add_artifacts(connection, new.id, outcome.files)
            outcome.publish(removal_lookup(connection))
            return True

        added = self._once(new, entry.key, entry.fingerprint, put)
        assert added is not None
        if step is not None and added == new.id:
            self._database.when_committed(partial(remove_unused, self._database, held, step.discard))
        return added

    def has_key(self, key_id: str, key: str | None) -> bool:
        """Whether an earlier request had this idempotency key."""
        if key is None:
            return False
        with self._read() as connection:
            return connection.execute(_KNOWN_KEY, {"key_id": key_id, "key": key}).first() is not None

    def find_repeated(self, key_id: str, key: str | None, fingerprint: str) -> str | None:
        """The mesh of an earlier request with this idempotency key; raises :class:`KeyReusedError`."""
        if key is None:
            return None
        here = (idempotency.c.key_id == key_id, idempotency.c.key == key)
        query = select(idempotency.c.fingerprint, idempotency.c.mesh_id).where(*here)
        with self._read() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None
        if row.fingerprint != fingerprint:
            raise KeyReusedError(key)
        return str(row.mesh_id)

    def reuse(self, new: NewMesh, *, key: str | None = None, fingerprint: str = "") -> str | None:
        """Insert a mesh as a copy of an earlier success of the same ``new.fingerprint`` and API key.

        The new mesh shares the files of the earlier one. Returns its id, for a repeated ``key`` as :meth:`add`, and
        None when there is no such mesh. Raises as :meth:`add`.
        """

        def put(connection: Connection) -> bool:
            # Locked, so that its files are not removed before the new mesh names them.
            source = connection.execute(_EQUAL_LOCKED, _points_of(new)).first()
            if source is not None:
                insert_reused(connection, new, source.id, source.result, self._clock())
            return source is not None

        return self._once(new, key, fingerprint, put)

    def has_equal(self, new: NewMesh) -> bool:
        """Whether there is an earlier success of the same ``new.fingerprint`` and API key."""
        if new.fingerprint is None:
            return False
        with self._read() as connection:
            return connection.execute(_EQUAL, _points_of(new)).first() is not None

    def get(self, mesh_id: str) -> MeshRow | None:
        """The mesh with this id."""
        with self._read() as connection:
            row = connection.execute(_SHOW, {"mesh": mesh_id}).first()
        return None if row is None else _mesh(row)

    def several(self, names: Sequence[str]) -> dict[str, MeshRow]:
        """The rows of the meshes with these ids that exist, by id."""
        found: dict[str, MeshRow] = {}
        with self._read() as connection:
            for start in range(0, len(names), _MAX_IDS_PER_QUERY):
                here = meshes.c.id.in_(names[start : start + _MAX_IDS_PER_QUERY])
                found |= {row.id: _mesh(row) for row in connection.execute(select(*_SHOWN).where(here))}
        return found

    def find_unfinished(self, names: Sequence[str]) -> dict[str, int]:
        """The number of the last event of each of these meshes that is not finished."""
        found: dict[str, int] = {}
        with self._read() as connection:
            for start in range(0, len(names), _MAX_IDS_PER_QUERY):
                here = meshes.c.id.in_(names[start : start + _MAX_IDS_PER_QUERY])
                rows = connection.execute(select(meshes.c.id, meshes.c.status, meshes.c.last_event).where(here))
                found |= {row.id: row.last_event for row in rows if row.status not in FINISHED}
        return found

    def spec(self, mesh_id: str) -> dict[str, Any] | None:
        """The canonical spec of a mesh."""
        with self._read() as connection:
            text = connection.execute(select(meshes.c.spec).where(meshes.c.id == mesh_id)).scalar()
        return None if text is None else json.loads(text)

    def get_input(self, mesh_id: str) -> MeshInput | None:
        """The input of a mesh for a worker; None when the mesh is gone."""
        query = select(meshes.c.spec, meshes.c.format).where(meshes.c.id == mesh_id)
        with self._read() as connection:
            row = connection.execute(query).first()
            if row is None:
                return None
            held = _samples_of(connection, mesh_id)
            columns = steps.c.start, steps.c.fields, steps.c.settings
            step = connection.execute(select(*columns).where(steps.c.mesh_id == mesh_id)).first()
        more = {} if step is None else step._asdict()
        return MeshInput(spec=json.loads(row.spec), format=row.format, samples=held, **more)

    def page(
        self,
        *,
        key_id: str | None = None,
        status: str | None = None,
        label: str | None = None,
        before: Position | None = None,
        limit: int = 50,
    ) -> list[MeshRow]:
        """Meshes, newest first, after the position ``before``; of one key, unless it is None."""
        order = (meshes.c.number,) if key_id is None else (meshes.c.created_at, meshes.c.id)
        query = select(*_SHOWN).order_by(*(column.desc() for column in order)).limit(limit)
        if key_id is not None:
            query = query.where(meshes.c.key_id == key_id)
        if status is not None:
            query = query.where(meshes.c.status == status)
        if label is not None:
            query = query.where(meshes.c.label == label)
        if before is not None:
            query = query.where(tuple_(*order) < before)
        with self._read() as connection:
            return [_mesh(row) for row in connection.execute(query)]

    def delete(self, mesh_id: str, remove_file: Callable[[str], None]) -> bool:
        """Delete a mesh with its events and artifacts; ``remove_file`` is called for files that no other row names."""
        with self._write() as connection:
            deleted = delete_meshes(connection, [mesh_id], self._clock())
        if deleted.sequences:
            with self._write() as connection:
                delete_ended(connection, deleted.sequences)
        remove_unused(self._database, deleted.files, remove_file)
        return bool(deleted.meshes)

    def events(self, mesh_id: str, *, after: int = 0, limit: int = 1000) -> list[EventRow]:
        """The events of a mesh after event number ``after``."""
        query = (
            select(events.c.number, events.c.time, events.c.kind, events.c.data)
            .where(events.c.mesh_id == mesh_id, events.c.number > after)
            .order_by(events.c.number)
            .limit(limit)
        )
        with self._read() as connection:
            return [EventRow(*row) for row in connection.execute(query)]

    def artifact(self, mesh_id: str, name: str) -> Artifact | None:
        """The file of a mesh under a name."""
        columns = (artifacts.c.name, artifacts.c.sha256, artifacts.c.size)
        query = select(*columns).where(artifacts.c.mesh_id == mesh_id, artifacts.c.name == name)
        with self._read() as connection:
            row = connection.execute(query).first()
        return None if row is None else Artifact(*row)

    def artifacts(self, mesh_id: str) -> dict[str, Artifact]:
        """All files of a mesh, by their names."""
        columns = (artifacts.c.name, artifacts.c.sha256, artifacts.c.size)
        with self._read() as connection:
            rows = connection.execute(select(*columns).where(artifacts.c.mesh_id == mesh_id)).all()
        return {row.name: Artifact(*row) for row in rows}

    def add_artifact(self, mesh_id: str, file: Artifact, publish: Publish = publish_nothing) -> bool:
        """Give a finished mesh one more file, which a crash may undo; False when the mesh is gone."""
        with self._write(durable=False) as connection:
            query = select(meshes.c.id).where(meshes.c.id == mesh_id).with_for_update(key_share=True)
            if connection.execute(query).first() is None:
                return False
            insert_artifacts(connection, mesh_id, [file])
            publish(removal_lookup(connection))
            return True

    def _once(self, new: NewMesh, key: str | None, fingerprint: str, put: Callable[[Connection], bool]) -> str | None:
        """Insert a mesh by ``put`` unless its key is known; returns the id, None when ``put`` returns False."""
        known = self.find_repeated(new.key_id, key, fingerprint)
        if known is not None:
            return known
        try:
            with self._write() as connection:
                if not put(connection):
                    return None
                if key is not None:
                    row = {"key_id": new.key_id, "key": key, "fingerprint": fingerprint, "mesh_id": new.id}
                    connection.execute(insert(idempotency).values(row))
        except (IntegrityError, StepTakenError):
            known = self.find_repeated(new.key_id, key, fingerprint)  # a request with the same key was faster
            if known is None:
                raise
            return known
        return new.id


def _samples_of(connection: Connection, mesh_id: str) -> dict[str, str]:
    """The SHA-256 of the files of the samples that a mesh uses, by their ids."""
    return {row.id: row.sha256 for row in _SAMPLES_OF.execute(connection, {"mesh": mesh_id})}


def _points_of(new: NewMesh) -> dict[str, Any]:
    return {"points": new.fingerprint, "key": new.key_id}


def _mesh(row: Row[Any]) -> MeshRow:
    return MeshRow(**row._mapping)
