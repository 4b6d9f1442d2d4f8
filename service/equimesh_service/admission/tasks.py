"""What workers are given and what they return: requests as they came, admitted specs and packed problems.

Nothing here needs the solver, which the process with the connections imports when it checks a request itself.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from equimesh_service.admission.callers import Caller
from equimesh_service.engine.port import NamedFunction
from equimesh_service.settings import Settings
from equimesh_service.store.keys import Quota
from equimesh_service.store.rows import Claim, Ending, Lease, NewMesh, NewSamples
from equimesh_service.worker.job import Storage

if TYPE_CHECKING:
    from equimesh.specs.spec import BuiltSpec

COMPUTE = NamedFunction("equimesh_service.admission.computation:compute")
"""From a :class:`Computation` to a :class:`ComputationResult`."""
ANSWER = NamedFunction("equimesh_service.admission.computation:answer")
"""From a :class:`Request` to the end of its mesh."""
MAX_STEP_POINTS = 20_000
"""The most points of a mesh whose steps go to workers as they came."""
MAX_PACKED_BYTES = 128 * 2**20
"""The most bytes of all problems that wait for a worker in one process."""
# Bytes of a point in the files of a mesh in parts: x, y, z, u, its number and its sides; corners, end, type and part of
# a cell.
BYTES_OF_POINT = 66
_VERSION = version("equimesh")


@dataclass(frozen=True)
class AdmittedSpec:
    """A canonical spec that will be solved, and the SHA-256 of the files of its samples, by the ids of these."""

    spec: Mapping[str, Any]
    samples: Mapping[str, str]
    digest: str  # equal for specs of the same points
    built: BuiltSpec | None = None  # its problem, in the process that has checked it
    packed: bytes | None = None  # the same, on its way to the worker that solves it
    upload: NewSamples | None = None  # samples that are not stored yet
    nodes: int | None = None  # of a mesh of blocks: its points
    uploads: int = 0  # the files that came with the request
    target_pointer: str = "/target"  # where its target was sent

    @property
    def problem(self) -> BuiltSpec:
        """Its problem, in a worker, which checks every spec by building it."""
        assert self.built is not None
        return self.built

    @property
    def is_in_parts(self) -> bool:
        """Whether a cluster computes the mesh, in parts."""
        return self.spec["parts"] is not None

    @property
    def expected_bytes(self) -> int:
        """The bytes of the files of a mesh in parts, about; 0 for others, whose files are small."""
        grid = self.spec["grid"]
        return BYTES_OF_POINT * grid["n_xi"] * grid["n_eta"] if self.is_in_parts else 0

    @property
    def points_fingerprint(self) -> str:
        """Equal for meshes of the same release with the same points."""
        return sha256(f"{self.digest} {_VERSION}".encode()).hexdigest()

    def new_mesh(self, claim: Claim, format: str | None) -> NewMesh:
        """The row of its mesh, with the id, key, request and trace of a claim."""
        return NewMesh(
            id=claim.mesh_id,
            spec=self.spec,
            samples=tuple(self.samples),
            format=format,
            key_id=claim.key_id,
            request_id=claim.request_id,
            trace=claim.trace,
            fingerprint=self.points_fingerprint,
            nodes=self.nodes,
        )

    def fingerprint(self, format: str | None) -> str:
        """Equal for equal requests, also in different releases: a retry may reach a newer one."""
        more = json.dumps([self.spec["label"], self.spec["cells"], format])
        return sha256(f"{self.digest} {more}".encode()).hexdigest()


@dataclass(frozen=True, kw_only=True)
class Computation:
    """The task of a worker: a request as it came, and the form of its answer.

    ``format`` is a format of meshes, :data:`~equimesh_service.worker.job.DRAWING` for all that is needed to draw the
    mesh, or None for its document alone. With ``frames`` a drawing has the meshes of a Schwarz iteration. ``settings``
    have the limits. The solve ends itself after ``seconds``, since a killed worker is slow to replace.
    """

    content_type: str
    body: bytes
    format: str | None
    frames: bool = False
    caller: Caller
    settings: Settings
    storage: Storage
    seconds: float
    request_id: str = ""


@dataclass(frozen=True, kw_only=True)
class ComputationResult:
    """The bytes of an answer, the JSON of the certificate, and how the solve ended."""

    content: bytes
    certificate: str
    ending: Ending


@dataclass(frozen=True, kw_only=True)
class StepPlace:
    """The step of a sequence that a new one follows, its mesh, and the points of that.

    ``keep`` is the number of meshes that are kept, and ``fingerprint`` is equal for equal requests.
    """

    sequence_id: str
    number: int
    mesh_id: str
    points: int
    keep: int
    fingerprint: str


@dataclass(frozen=True, kw_only=True)
class Request:
    """The task of a worker: a request for a mesh that is kept, as it came, and the ``claim`` of the mesh to be.

    ``format`` is that of the requested file. With ``reuse`` a finished mesh of the same spec may answer it. ``key`` is
    its idempotency key, ``quota`` has the limits of its API key. A mesh that is not finished soon is entered into the
    store under the ``lease``. The ``place`` makes it a step of a sequence.
    """

    content_type: str
    body: bytes
    format: str | None
    caller: Caller
    settings: Settings
    storage: Storage
    claim: Claim
    key: str | None
    reuse: bool
    quota: Quota | None
    lease: Lease
    place: StepPlace | None = None


class PackedProblems:
    """The checked problems of meshes that no worker has yet, as bytes by the ids of the meshes.

    The oldest are forgotten where all have more than ``max_bytes``. A worker builds a forgotten one from the store.
    """

    def __init__(self, max_bytes: int = MAX_PACKED_BYTES) -> None:
        self._max_bytes = max_bytes
        self._lock = threading.Lock()  # guards the next one
        self._of_meshes: dict[str, bytes] = {}

    def put(self, mesh_id: str, packed: bytes) -> None:
        """Keep the problem of a mesh until it is taken."""
        with self._lock:
            self._of_meshes[mesh_id] = packed
            left = sum(map(len, self._of_meshes.values())) - self._max_bytes
            for oldest in [*self._of_meshes]:
                if left <= 0:
                    return
                left -= len(self._of_meshes.pop(oldest))

    def take(self, mesh_id: str) -> bytes | None:
        """The problem of a mesh, which is forgotten; None for one that is not here."""
        with self._lock:
            return self._of_meshes.pop(mesh_id, None)
