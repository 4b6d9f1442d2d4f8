"""The tasks of workers: picklable records with the addresses of database and files."""

from dataclasses import dataclass, field

from equimesh_service.files.address import FilesAddress
from equimesh_service.files.port import Files
from equimesh_service.store.rows import Claim, MeshInput
from equimesh_service.store.store import Store


@dataclass(frozen=True)
class Storage:
    """The addresses of the database and the files of a service."""

    database_url: str
    address: FilesAddress

    def store(self, *, durable: bool) -> Store:
        """The database of a worker; its commits wait for the disk only when they are to be ``durable``."""
        return Store(self.database_url, durable=durable)

    def files(self) -> Files:
        """The files."""
        return self.address.open()


@dataclass(frozen=True)
class Job:
    """One attempt at a mesh, on a number of threads; a mesh in parts is computed on the cluster of ``scheduler``."""

    storage: Storage
    claim: Claim
    threads: int = 1
    mesh_input: MeshInput | None = None  # None: the worker reads it from the store
    scheduler: str = ""
    packed: bytes | None = None  # the problem, where the check has built it


@dataclass(frozen=True)
class Export:
    """A file to be written for a finished mesh: ``name`` as in :mod:`equimesh_service.worker.names`."""

    storage: Storage
    mesh_id: str
    name: str
    request_id: str = field(default="", compare=False)  # of the first request, for log lines
    trace: str | None = field(default=None, compare=False)
