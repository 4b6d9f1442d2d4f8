"""SQL of drafts: meshes that a worker computes before the store knows of them.

A request that waits for a small mesh is answered after one transaction. Nothing is promised before it, so nothing is
stored before it. A draft that takes longer is entered as a running mesh, which can be listed, canceled and retried. The
service enters it and the worker finishes it; whoever comes second finds the row of the first.
"""

from collections.abc import Callable

from sqlalchemy import Connection, bindparam, insert, select
from sqlalchemy.exc import IntegrityError

from equimesh_service.files.port import Publish
from equimesh_service.store.artifacts import insert_artifacts, removal_lookup
from equimesh_service.store.database import Database, lock
from equimesh_service.store.insertion import insert_finished, insert_waiting, use_samples
from equimesh_service.store.meshes import MeshesStore
from equimesh_service.store.queue import QueueStore
from equimesh_service.store.quotas import Quota, take
from equimesh_service.store.rows import Claim, Draft, Lease, Outcome
from equimesh_service.store.samples import insert_samples
from equimesh_service.store.schema import idempotency, meshes

# Built once, since building statements takes longer than executing them.
_EXISTS = select(meshes.c.id).where(meshes.c.id == bindparam("mesh"))
_ADD_KEY = insert(idempotency)


class DraftStore:
    """Drafts, on their two ways into the store."""

    def __init__(
        self, database: Database, meshes_store: MeshesStore, queue: QueueStore, clock: Callable[[], float]
    ) -> None:
        self._database, self._meshes, self._queue, self._clock = database, meshes_store, queue, clock

    def exists(self, mesh_id: str) -> bool:
        """Whether the mesh of a draft is in the store."""
        with self._database.read() as connection:
            return connection.execute(_EXISTS, {"mesh": mesh_id}).first() is not None

    def enter(self, draft: Draft, lease: Lease, quota: Quota | None) -> str:
        """Put a draft whose samples are stored into the store, as running; nothing happens when it is there already.

        Returns its id, for a repeated idempotency key that of the earlier mesh. Raises as
        :meth:`~equimesh_service.store.meshes.MeshesStore.add`.
        """
        new = draft.new
        known = self._meshes.find_repeated(new.key_id, draft.key, draft.fingerprint)
        if known is not None:
            return known
        try:
            with self._database.write() as connection:
                if connection.execute(_EXISTS, {"mesh": new.id}).first() is None:
                    if quota is not None:
                        take(connection, new.key_id, new.points, quota)
                    insert_waiting(connection, new, lease, self._clock())
                    _insert_key(connection, draft)
        except IntegrityError:  # its worker, or a request with the same key, was faster
            return self._meshes.find_repeated(new.key_id, draft.key, draft.fingerprint) or new.id
        return new.id

    def finish(
        self,
        draft: Draft,
        claim: Claim,
        outcome: Outcome,
        *,
        seconds: float,
        publish_samples: Publish,
        entered: bool = False,
    ) -> str | None:
        """Store a draft that was finished after ``seconds`` of work, or end the mesh that was entered meanwhile.

        Returns its id, for a repeated idempotency key that of the earlier mesh, and None when the claim is no longer
        valid. A draft that is known to be ``entered`` and is not there was deleted. Raises
        :class:`~equimesh_service.errors.KeyReusedError` and :class:`~equimesh_service.errors.SamplesGoneError`.
        """
        new = draft.new
        try:
            with self._database.write() as connection:
                if not entered and connection.execute(_EXISTS, {"mesh": new.id}).first() is None:
                    self._insert(connection, draft, outcome, seconds, publish_samples)
                    return new.id
        except IntegrityError:  # the service, or a request with the same key, was faster
            known = self._meshes.find_repeated(new.key_id, draft.key, draft.fingerprint)
            if known not in (None, new.id):
                return known
        return new.id if self._queue.finish(claim, outcome) else None

    def _insert(
        self, connection: Connection, draft: Draft, outcome: Outcome, seconds: float, publish_samples: Publish
    ) -> None:
        now, files = self._clock(), [file.sha256 for file in outcome.files]
        new, sent = draft.new, draft.samples
        # The mesh first, then samples and files, as in all transactions: so no two wait for each other.
        insert_finished(connection, new, outcome, now, seconds)
        lock(connection, files if sent is None else [sent.row.sha256, *files])
        if sent is not None:
            insert_samples(connection, sent.row, publish_samples, key_id=new.key_id, now=now)
        use_samples(connection, new, now)
        insert_artifacts(connection, new.id, outcome.files)
        _insert_key(connection, draft)
        outcome.publish(removal_lookup(connection))


def _insert_key(connection: Connection, draft: Draft) -> None:
    if draft.key is not None:
        new = draft.new
        row = {"key_id": new.key_id, "key": draft.key, "fingerprint": draft.fingerprint, "mesh_id": new.id}
        connection.execute(_ADD_KEY, row)
