"""The tasks of workers, their log context, and the names of the artifacts of a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache

from equimesh_service.files.address import FilesAddress
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.rows import Claim, MeshInput
from equimesh_service.store.store import Store
from equimesh_service.telemetry import tracing
from equimesh_service.telemetry.log_context import LogContext
from equimesh_service.telemetry.tracing import Attributes


@dataclass(frozen=True)
class Storage:
    """The addresses of the database and the files of a service."""

    database_url: str
    address: FilesAddress

    def store(self) -> Store:
        """The database, opened once in each process."""
        return _open_store(self.database_url)

    def files(self) -> BlobFiles:
        """The files."""
        return BlobFiles(self.store().database, self.address.open())


@lru_cache(maxsize=8)
def _open_store(url: str) -> Store:
    return Store(url)


@dataclass(frozen=True)
class Job:
    """One attempt at a mesh, on a number of threads; a mesh in parts is computed on the cluster of ``scheduler``."""

    storage: Storage
    claim: Claim
    threads: int = 1
    mesh_input: MeshInput | None = None  # None: the worker reads it from the store
    scheduler: str = ""
    packed: bytes | None = None  # the problem, where the check has built it
    hands_over: bool = False  # small files go back to the service, which puts the mesh into the store


@dataclass(frozen=True)
class Export:
    """A file to be written for a finished mesh: ``name`` as in :mod:`equimesh_service.worker.job`."""

    storage: Storage
    mesh_id: str
    name: str
    request_id: str = field(default="", compare=False)  # of the first request, for log lines
    trace: str | None = field(default=None, compare=False)


def log_context_of(claim: Claim) -> LogContext:
    """The log context of an attempt, with the id and the key of the request."""
    return LogContext(request_id=claim.request_id or "", mesh_id=claim.mesh_id, key_id=claim.key_id)


@contextmanager
def attempt(claim: Claim) -> Iterator[None]:
    """The spans of an attempt at a mesh: its past wait in the queue, and the work of the worker."""
    tracer = tracing.current()
    if tracer is None or claim.trace is None:
        yield
        return
    tracer.record("queue wait", claim.trace, claim.claimed_at - claim.waited, claim.claimed_at)
    attributes: Attributes = {"equimesh.mesh.id": claim.mesh_id, "equimesh.mesh.attempt": claim.attempt}
    with tracer.span("attempt", attributes, parent=claim.trace):
        yield


# The mesh as it was computed.
MESH = "mesh"
# The history of the Schwarz iteration.
CONVERGENCE = "convergence"
# The quality of each cell.
ARRAYS = "quality:arrays"
# All that a page needs to draw the mesh.
DRAWING = "drawing"
# The kinds of pictures.
PLOTS = ("mesh", "convergence", "quality", "comparison")
# The media types of pictures, by their formats.
PICTURES = {"svg": "image/svg+xml", "png": "image/png"}


def file_name(format: str, cells: str, order: int = 1) -> str:
    """The name of the artifact of a mesh in a format; npz with quads is the mesh as it was computed."""
    name = MESH if (format, cells) == ("npz", "quad") else f"file:{format}:{cells}"
    return name if order == 1 else f"{name}:second order"


def plot_name(kind: str, format: str) -> str:
    """The name of the artifact of a picture."""
    return f"plot:{kind}:{format}"


def head_name(format: str) -> str:
    """The name of the artifact of the head of a mesh in parts, which names the files of its parts."""
    return f"head:{format}"


def part_artifact(format: str, number: int) -> str:
    """The name of the artifact of a part, whose numbers are 0, 1, 2, …."""
    return f"part:{format}:{number}"
