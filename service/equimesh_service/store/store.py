"""The store: the database of the service, in parts by what they know."""

from collections.abc import Callable

from sqlalchemy import false, update

from equimesh_service.store import database
from equimesh_service.store.clock import describe_skew, skew
from equimesh_service.store.database import Database
from equimesh_service.store.keys import KeyStore, QuotaStore
from equimesh_service.store.meshes import MeshesStore, SequencesStore
from equimesh_service.store.queue import QueueStore
from equimesh_service.store.retention import RetentionStore
from equimesh_service.store.samples import SamplesStore
from equimesh_service.store.schema import samples


class Store:
    """The database behind a URL. One object serves all threads of a process.

    ``clock`` returns the time in seconds since 1970; it is the database's unless another one is given.
    """

    def __init__(self, url: str, *, clock: Callable[[], float] | None = None) -> None:
        self.database = Database(url)
        self.clock = clock = clock or self.database.clock
        self.meshes = MeshesStore(self.database, clock)
        self.queue = QueueStore(self.database, clock)
        self.samples = SamplesStore(self.database, clock)
        self.sequences = SequencesStore(self.database, clock)
        self.retention = RetentionStore(self.database, clock)
        self.keys = KeyStore(self.database, clock)
        self.quotas = QuotaStore(self.database)

    def prepare(self) -> None:
        """Create the tables, or upgrade the tables of an older release.

        Raises :class:`~equimesh_service.errors.NewerDatabaseError`.
        """
        database.prepare(self.database)

    def close(self) -> None:
        """Close all connections."""
        self.database.close()

    def clock_warning(self) -> str | None:
        """A sentence about this machine's clock where it differs from the database's, else None."""
        return describe_skew(skew(self.clock))

    def check(self) -> None:
        """Raise when the database does not answer, or takes no writes now."""
        with self.database.write(durable=False) as connection:
            # It changes no row. A server that is set to take no writes refuses it all the same.
            connection.execute(update(samples).where(false()).values(used_at=samples.c.used_at))
