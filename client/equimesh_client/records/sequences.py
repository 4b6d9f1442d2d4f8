"""Sequences in the list of a service."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from equimesh_schema import Certificate


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
