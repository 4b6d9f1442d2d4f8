"""SQL of the usage of a key: unfinished meshes, their points, and stored bytes."""

from dataclasses import dataclass

from sqlalchemy import BigInteger, Connection, cast, func, select

from equimesh_service.errors import QuotaError
from equimesh_service.store.database import Database, lock
from equimesh_service.store.rows import QUEUED, RUNNING
from equimesh_service.store.schema import artifacts, meshes, samples, samples_keys


@dataclass(frozen=True, kw_only=True)
class Quota:
    """The most unfinished meshes of a key and the most points of them; 0: no limit."""

    queued: int
    points: int


def take(connection: Connection, key_id: str, points: int, quota: Quota) -> None:
    """Check that one more mesh fits, in this writing transaction; raises :class:`QuotaError`.

    Until the transaction ends, no other one in any process checks the same key, so the limit holds exactly.
    """
    if not (quota.queued or quota.points):
        return
    lock(connection, [f"quota {key_id}"])
    _check(connection, key_id, points, quota)


def _check(connection: Connection, key_id: str, points: int, quota: Quota) -> None:
    # `coalesce` keeps the query from the index of all meshes of the key, most of which are finished.
    mine = func.coalesce(meshes.c.key_id, "") == key_id
    # With 64 bits: a mesh on a cluster may have more points than 32 bits count.
    total = func.coalesce(func.sum(cast(meshes.c.n_xi, BigInteger) * meshes.c.n_eta), 0)
    query = select(func.count(), total).where(meshes.c.status.in_((QUEUED, RUNNING)), mine)
    number, used = connection.execute(query).one()
    if quota.queued and number >= quota.queued:
        raise QuotaError("key_max_queued", int(number), quota.queued)
    if quota.points and used + points > quota.points:
        raise QuotaError("key_max_points", int(used), quota.points)


class QuotaStore:
    """The usage of keys."""

    def __init__(self, database: Database) -> None:
        self._read = database.read

    def check(self, key_id: str, points: int, quota: Quota) -> None:
        """Check that one more mesh would fit now; raises :class:`QuotaError`."""
        if quota.queued or quota.points:
            with self._read() as connection:
                _check(connection, key_id, points, quota)

    def stored_bytes(self, key_id: str) -> int:
        """Bytes of the files and specs of a key's meshes, and of its samples.

        A file that several share counts for each.
        """
        specs = select(func.coalesce(func.sum(meshes.c.spec_size), 0))
        files = select(func.coalesce(func.sum(artifacts.c.size), 0)).join(meshes, meshes.c.id == artifacts.c.mesh_id)
        uploads = select(func.coalesce(func.sum(samples.c.size), 0)).join(
            samples_keys, samples_keys.c.samples_id == samples.c.id
        )
        with self._read() as connection:
            made = connection.execute(files.where(meshes.c.key_id == key_id)).scalar_one()
            sent = connection.execute(uploads.where(samples_keys.c.key_id == key_id)).scalar_one()
            specified = connection.execute(specs.where(meshes.c.key_id == key_id)).scalar_one()
        return int(made) + int(sent) + int(specified)
