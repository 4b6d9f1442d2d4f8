"""The records that the store takes and returns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isqrt
from typing import Any

from equimesh_service.files.port import Publish, publish_nothing

# The mesh waits for a worker.
QUEUED = "queued"
# A worker computes it.
RUNNING = "running"
# Its files are there.
SUCCEEDED = "succeeded"
# Its error says why; the last valid mesh may be there.
FAILED = "failed"
# A client ended it.
CANCELED = "canceled"
STATUSES = (QUEUED, RUNNING, SUCCEEDED, FAILED, CANCELED)
FINISHED = (SUCCEEDED, FAILED, CANCELED)
# The start of the ids of samples at the nodes of a mesh. They come with a step of a sequence and go with its mesh.
NODAL = "n-"
# The end of a page of meshes: a number, for callers who see all meshes; a time and an id, for others.
Position = tuple[int] | tuple[float, str]


def keep_file(_: str) -> None:
    """Remove nothing."""


@dataclass(frozen=True)
class Artifact:
    """A file that belongs to a mesh."""

    name: str
    sha256: str
    size: int


@dataclass(frozen=True, kw_only=True)
class NewMesh:
    """A new mesh, to be inserted."""

    id: str
    spec: Mapping[str, Any]
    samples: tuple[str, ...] = ()
    format: str | None = None
    key_id: str = ""
    request_id: str | None = None
    trace: str | None = None
    fingerprint: str | None = None  # equal for meshes of the same points
    nodes: int | None = None  # of a mesh of blocks: its points

    @property
    def shape(self) -> tuple[int, int]:
        """The points of the mesh along xi and eta; with a target the points of the largest square grid that it allows.

        The nodes of a mesh of blocks are one row.
        """
        if self.nodes is not None:
            return self.nodes, 1
        if self.spec.get("target") is not None:
            side = isqrt(int(self.spec["target"]["max_points"]))
            return side, side
        return int(self.spec["grid"]["n_xi"]), int(self.spec["grid"]["n_eta"])

    @property
    def points(self) -> int:
        """The number of its points."""
        return self.shape[0] * self.shape[1]


@dataclass(frozen=True, kw_only=True)
class MeshRow:
    """The current row of a mesh; see :mod:`equimesh_service.store.schema` for the columns."""

    number: int
    id: str
    status: str
    label: str | None
    n_xi: int
    n_eta: int
    cells: str
    format: str | None
    created_at: float
    started_at: float | None
    finished_at: float | None
    attempt: int
    last_event: int
    progress: dict[str, Any] | None
    result: dict[str, Any] | None
    error: dict[str, Any] | None
    partial: bool
    key_id: str
    reused_from: str | None

    @property
    def has_grid(self) -> bool:
        """Whether the mesh is a grid, not one of blocks, whose nodes are one row."""
        return self.n_eta > 1

    @property
    def finished(self) -> bool:
        """Whether the mesh has succeeded, failed or been canceled."""
        return self.status in FINISHED


@dataclass(frozen=True)
class EventRow:
    """One event of a mesh."""

    number: int
    time: float
    kind: str
    data: dict[str, Any]


@dataclass(frozen=True)
class Claim:
    """The right to compute a mesh, until another attempt begins.

    Also its origin: the time of the claim, the seconds that the mesh had waited, and its request, key and trace.
    """

    mesh_id: str
    attempt: int
    claimed_at: float = field(default=0.0, compare=False)
    waited: float = field(default=0.0, compare=False)
    request_id: str | None = field(default=None, compare=False)
    key_id: str = field(default="", compare=False)
    trace: str | None = field(default=None, compare=False)


@dataclass(frozen=True)
class SamplesRow:
    """Stored samples."""

    id: str
    sha256: str
    size: int
    summary: dict[str, Any]
    created_at: float


@dataclass(frozen=True)
class NewSamples:
    """Samples to be stored: their row, and the bytes of their file."""

    row: SamplesRow
    archive: bytes


@dataclass(frozen=True, kw_only=True)
class NewEntry:
    """All that enters the store with a new mesh: its row, the samples that came with its request, and its key.

    ``key`` is the idempotency key of the request and ``fingerprint`` its fingerprint. The samples are a small file. The
    ``step`` makes the mesh one of a sequence.
    """

    new: NewMesh
    samples: NewSamples | None = None
    key: str | None = None
    fingerprint: str = ""
    step: "NewStep | None" = None


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a worker's job: the result, the error of a failed mesh, and the files.

    ``publish`` gives the files their names. With ``partial`` they are the files of a mesh that failed.
    """

    error: Mapping[str, Any] | None = None
    result: Mapping[str, Any] | None = None
    files: Sequence[Artifact] = ()
    partial: bool = False
    publish: Publish = publish_nothing

    @property
    def status(self) -> str:
        """The status of the mesh."""
        return SUCCEEDED if self.error is None else FAILED

    @property
    def event(self) -> dict[str, Any]:
        """The data of the last event."""
        return {"status": self.status} if self.error is None else {"status": self.status, "error": dict(self.error)}

    @property
    def columns(self) -> dict[str, Any]:
        """The columns of the row of the mesh."""
        return {
            "status": self.status,
            "error": None if self.error is None else dict(self.error),
            "result": None if self.result is None else dict(self.result),
            "partial": self.partial,
        }


@dataclass(frozen=True, kw_only=True)
class KeysInQueue:
    """The shares of the keys with waiting meshes, the key of the oldest mesh first; how many meshes of keys run."""

    shares: Mapping[str, int]
    running: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class MeshInput:
    """The input of a worker: the spec of a mesh, the files of its samples, and the requested format."""

    spec: Mapping[str, Any]
    samples: Mapping[str, str]  # from the ids of samples to the SHA-256 of their files
    format: str | None = None
    start: str | None = None  # the SHA-256 of the npz file of the mesh that it starts from, as the step of a sequence
    fields: str | None = None  # that of the fields at the nodes of the start, which are transferred to the new mesh
    settings: Mapping[str, Any] | None = None  # of a step: how the mesh moves, and what is known of the start


@dataclass(frozen=True, kw_only=True)
class Followed:
    """What a step needs of the mesh that it follows: its spec, and the SHA-256 of its file.

    ``samples`` are the SHA-256 of their files by their ids, ``settings`` those of the step that the mesh was, and
    ``gains`` those of interpolation by their norms.
    """

    spec: Mapping[str, Any]
    file: str
    samples: Mapping[str, str]
    settings: Mapping[str, Any]
    gains: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class QueueCounts:
    """The number of meshes of each status, and the seconds that the oldest waiting one has waited."""

    meshes: Mapping[str, int]
    oldest_wait: float


@dataclass(frozen=True, kw_only=True)
class Lease:
    """The owner of claims, and the seconds after which a claim expires unless it is renewed."""

    owner: str
    seconds: float


@dataclass(frozen=True, kw_only=True)
class NewStep:
    """A new step of a sequence, to be inserted; step 0 begins the sequence.

    ``fingerprint`` is equal for equal requests. ``settings`` are JSON for the worker. ``publish`` publishes the
    file of the ``fields``, and ``discard`` removes a file that no row names any more. ``functions`` at the nodes are
    stored with the step as samples, each with what publishes its file. On the way from a worker these functions publish
    nothing, and ``contents`` are the bytes of all files by their SHA-256.
    """

    sequence_id: str
    number: int
    keep: int
    fingerprint: str
    key_id: str = ""
    start: str | None = None
    fields: Artifact | None = None
    settings: Mapping[str, Any] | None = None
    publish: Publish = publish_nothing
    functions: Sequence[tuple[SamplesRow, Publish]] = ()
    contents: Mapping[str, bytes] = field(default_factory=dict)
    discard: Callable[[str], None] = keep_file


@dataclass(frozen=True, kw_only=True)
class SequenceRow:
    """The current row of a sequence, with the number of its last step that has not failed, and the mesh of that.

    ``status`` and ``points`` are those of the mesh.
    """

    id: str
    key_id: str
    keep: int
    created_at: float
    used_at: float
    number: int
    mesh_id: str
    status: str
    points: int


@dataclass(frozen=True, kw_only=True)
class Ending:
    """The end of a mesh: its status, the name of the problem of a failed one, and its cost where that is known.

    ``requested`` is the file of the requested format, and ``content`` has its bytes, where they are few. ``laps`` are
    the seconds of the parts of the work. ``uploads`` is the number of files that came with its request.
    """

    status: str
    reason: str = ""
    points: int = 0
    solve_seconds: float | None = None
    requested: Artifact | None = None
    content: bytes | None = None
    laps: Mapping[str, float] = field(default_factory=dict)
    uploads: int = 0


@dataclass(frozen=True, kw_only=True)
class FinishedMesh:
    """A mesh that a worker has finished after ``seconds`` of work. The service stores it.

    ``contents`` are the bytes of its files by their SHA-256. ``ending`` is its end once it is stored. ``entry`` is that
    of a mesh which is not in the store yet.
    """

    outcome: Outcome
    contents: Mapping[str, bytes]
    ending: Ending
    seconds: float
    entry: NewEntry | None = None


@dataclass(frozen=True, kw_only=True)
class NoMesh:
    """The end of a request of which a worker has made no mesh.

    It is refused with an ``error``, or its idempotency key belongs to the mesh ``earlier``, or its ``admitted`` spec
    needs no worker now, or is for the service to refuse or to queue.
    """

    error: Exception | None = None
    earlier: str = ""
    admitted: Any = None
