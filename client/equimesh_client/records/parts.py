"""The files of a mesh that a cluster has computed in parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True)
class FileOfParts:
    """A file of a mesh in parts.

    ``size`` in bytes and ``sha256`` are None until the service has made the file, at its first download.
    """

    name: str
    media_type: str
    size: int | None
    sha256: str | None

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> FileOfParts:
        """The file in the JSON of the service."""
        size, sha256 = record.get("size"), record.get("sha256")
        return cls(
            name=str(record["name"]),
            media_type=str(record["media_type"]),
            size=None if size is None else int(size),
            sha256=None if sha256 is None else str(sha256),
        )


@dataclass(frozen=True, kw_only=True)
class PartRecord:
    """Part ``number`` of a mesh: its own rows along xi are ``first`` to ``last - 1``.

    ``rows`` counts those of its file, which has the first row of the next part, too.
    """

    number: int
    first: int
    last: int
    rows: int
    file: FileOfParts

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> PartRecord:
        """The part in the JSON of the service."""
        numbers = {name: int(record[name]) for name in ("number", "first", "last", "rows")}
        return cls(**numbers, file=FileOfParts.from_json(record["file"]))


@dataclass(frozen=True, kw_only=True)
class Parts:
    """All files of a mesh in parts, in one format: the ``head``, which names the others, and those of the parts.

    ``size`` is that of all files in bytes; None while one of them is not made. ``head`` is None for npz.
    """

    format: str
    formats: tuple[str, ...]
    grid: tuple[int, int]
    size: int | None
    head: FileOfParts | None
    parts: tuple[PartRecord, ...]

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Parts:
        """The manifest in the JSON of the service."""
        head, size = record.get("head"), record.get("size")
        return cls(
            format=str(record["format"]),
            formats=tuple(map(str, record["formats"])),
            grid=(int(record["grid"]["n_xi"]), int(record["grid"]["n_eta"])),
            size=None if size is None else int(size),
            head=None if head is None else FileOfParts.from_json(head),
            parts=tuple(map(PartRecord.from_json, record["parts"])),
        )

    @property
    def count(self) -> int:
        """The number of parts."""
        return len(self.parts)
