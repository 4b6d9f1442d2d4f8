"""What a worker needs to know to do its work: a picklable record, and the rooms that it opens from it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from equimesh_service.files import FileStore
from equimesh_service.rows import Claim
from equimesh_service.store import Store


@dataclass(frozen=True)
class Place:
    """Where a service keeps its database and its files."""

    database_url: str
    folder: Path

    def store(self) -> Store:
        """The database, as a worker opens it."""
        return Store(self.database_url, durable=False)

    def files(self) -> FileStore:
        """The files."""
        return FileStore(self.folder / "files")


@dataclass(frozen=True)
class Job:
    """One attempt at a mesh, on so many threads."""

    place: Place
    claim: Claim
    threads: int = 1


@dataclass(frozen=True)
class Export:
    """A file to be made of a mesh that is done: ``name`` as in :mod:`equimesh_service.names`."""

    place: Place
    mesh_id: str
    name: str
