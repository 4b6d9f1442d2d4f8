"""What a worker needs to know to do its work: a picklable record, and the rooms that it opens from it."""

from __future__ import annotations

from dataclasses import dataclass, field

from equimesh_service.files.address import FilesAddress
from equimesh_service.files.port import Files
from equimesh_service.store.rows import SUCCEEDED, Artifact, Claim, Order
from equimesh_service.store.store import Store


@dataclass(frozen=True)
class Place:
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
    """One attempt at a mesh, on so many threads."""

    place: Place
    claim: Claim
    threads: int = 1
    order: Order | None = None  # what the store knows of the mesh, where it need not be asked


@dataclass(frozen=True, kw_only=True)
class Ending:
    """How a mesh ended: its status, and for a failed one the name of the problem; what it cost, where that is known."""

    status: str
    reason: str = ""
    points: int = 0
    solve_seconds: float | None = None
    files: tuple[Artifact, ...] = ()

    def file(self, name: str) -> Artifact | None:
        """The file of a mesh that has succeeded, under a name; None where the worker made no such file."""
        found = (file for file in self.files if file.name == name)
        return next(found, None) if self.status == SUCCEEDED else None


@dataclass(frozen=True)
class Export:
    """A file to be made of a mesh that is done: ``name`` as in :mod:`equimesh_service.names`."""

    place: Place
    mesh_id: str
    name: str
    request_id: str = field(default="", compare=False)  # that which asked first, for log lines
    trace: str | None = field(default=None, compare=False)
