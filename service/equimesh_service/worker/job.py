"""Tasks of workers: picklable records, with the addresses of database and files."""

from dataclasses import dataclass, field

from equimesh_service.files.address import FilesAddress
from equimesh_service.files.port import Files
from equimesh_service.store.rows import Claim, MeshInput
from equimesh_service.store.store import Store


@dataclass(frozen=True)
class Storage:
    """Where a service keeps its database and its files."""

    database_url: str
    address: FilesAddress

    def store(self) -> Store:
        """The database, as a worker opens it."""
        return Store(self.database_url, durable=False)

    def files(self) -> Files:
        """The files."""
        return self.address.open()


@dataclass(frozen=True)
class Job:
    """One attempt at a mesh, on a number of threads."""

    storage: Storage
    claim: Claim
    threads: int = 1
    mesh_input: MeshInput | None = None  # from the store, if it was read already


@dataclass(frozen=True)
class Export:
    """A file to be made of a mesh that is done: ``name`` as in :mod:`equimesh_service.worker.names`."""

    storage: Storage
    mesh_id: str
    name: str
    request_id: str = field(default="", compare=False)  # of the first request, for log lines
    trace: str | None = field(default=None, compare=False)
