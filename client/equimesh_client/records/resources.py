"""The resources of a service: a mesh and its progress, the files of its parts, a sequence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from equimesh_schema import Certificate
from equimesh_schema.document import real_or_nan

# The state and the progress of a mesh, from its resource.

FINISHED = frozenset({"succeeded", "failed", "canceled"})


@dataclass(frozen=True, kw_only=True)
class Progress:
    """The progress of a mesh: its ``stage``, the ``phase`` in words, ``fraction`` from 0 to 1, and the latest numbers.

    ``fraction`` is None where the service does not know how much work is ahead.
    ``gain`` is that of a descent: how many times smaller the error is than on the uniform mesh. It has no ``residual``.
    """

    stage: str = ""
    iteration: int | None = None
    residual: float | None = None
    gain: float | None = None
    fraction: float | None = 0.0
    phase: str = ""


def progress_of(record: Mapping[str, Any]) -> Progress:
    """The progress of a mesh resource; of a finished one the fraction is 1."""
    progress = record.get("progress")
    progress = progress if isinstance(progress, dict) else {}
    given = 1.0 if record.get("status") == "succeeded" else progress.get("fraction", 0.0)
    fraction = real_or_nan(given)
    return Progress(
        stage=str(progress.get("stage") or record.get("status") or ""),
        iteration=progress["iteration"] if isinstance(progress.get("iteration"), int) else None,
        residual=None if progress.get("residual") is None else real_or_nan(progress["residual"]),
        gain=None if progress.get("gain") is None else real_or_nan(progress["gain"]),
        fraction=None if math.isnan(fraction) else min(1.0, max(0.0, fraction)),
        phase=str(progress.get("phase") or ""),
    )


class MeshState:
    """The state of a mesh in its latest resource, ``record``; nothing here sends a request."""

    def __init__(self, record: Mapping[str, Any]) -> None:
        self.record: dict[str, Any] = dict(record)

    @property
    def id(self) -> str:
        """The name of the mesh at the service."""
        return str(self.record["id"])

    @property
    def status(self) -> str:
        """``queued``, ``running``, ``succeeded``, ``failed`` or ``canceled``."""
        return str(self.record.get("status", "queued"))

    @property
    def is_finished(self) -> bool:
        """Whether the status is final."""
        return self.status in FINISHED

    @property
    def progress(self) -> Progress:
        """The progress of the mesh in the latest resource."""
        return progress_of(self.record)

    @property
    def label(self) -> str | None:
        """The label of the request."""
        return self.record.get("label")

    @property
    def error(self) -> dict[str, Any] | None:
        """The problem document of a failed mesh."""
        return self.record.get("error")

    @property
    def reused_from(self) -> str | None:
        """The earlier mesh of an equal request, whose files this one shares; None for a computed mesh."""
        found = self.record.get("reused_from")
        return None if found is None else str(found)

    @property
    def certificate(self) -> Certificate | None:
        """How well a finished mesh solves the requested equations: ``print(mesh.certificate)``."""
        found = self.record.get("certificate")
        return Certificate.from_json(found) if isinstance(found, dict) else None

    @property
    def relaxed(self) -> bool:
        """Whether the valid mesh solves a weaker or smoother monitor than requested; the certificate says which."""
        certificate = self.certificate
        return certificate is not None and certificate.status == "relaxed"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user of the mesh, in sentences; empty without any."""
        certificate = self.certificate
        return () if certificate is None else certificate.warnings

    @property
    def timings(self) -> dict[str, Any]:
        """Times of its request, start and end, and durations."""
        return self.record.get("timings") or {}

    @property
    def attempts(self) -> int:
        """How often a worker has started to solve it."""
        return int(self.record.get("attempts") or 0)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.id} {self.status}>"


@dataclass(frozen=True, kw_only=True)
class SequenceRecord:
    """A sequence at its current step, without arrays; ``client.sequences.get(id)`` continues it.

    ``number`` is that of the step, ``mesh_id`` its mesh, ``status`` that of the mesh. The service keeps the last
    ``keep`` meshes. ``created_at`` and ``used_at`` are times in ISO 8601. ``certificate`` is None before the mesh is
    finished. ``record`` is the JSON of the service.
    """

    id: str
    number: int
    mesh_id: str
    status: str
    keep: int
    created_at: str
    used_at: str
    certificate: Certificate | None
    record: Mapping[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> SequenceRecord:
        """The sequence in the JSON of the service."""
        mesh = record["mesh"]
        found = mesh.get("certificate")
        return cls(
            id=str(record["id"]),
            number=int(record["step"]),
            mesh_id=str(mesh["id"]),
            status=str(mesh.get("status") or ""),
            keep=int(record["keep"]),
            created_at=str(record["created_at"]),
            used_at=str(record["used_at"]),
            certificate=Certificate.from_json(found) if isinstance(found, dict) else None,
            record=dict(record),
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user of the current mesh, in sentences; empty without any."""
        return () if self.certificate is None else self.certificate.warnings
