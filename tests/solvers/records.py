"""Records of what other solvers did with our meshes: the tests write them, and the docs have a table of them."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path

RECORDS = Path(__file__).parents[2] / ".cache" / "consumers" / "records"


@dataclass(frozen=True, kw_only=True)
class Record:
    """One consumer on one mesh.

    ``format`` is that of the file, or ``"adaptor"``. ``mesh`` is ``"square quads"``, ``"square triangles"``,
    ``"annulus quads"`` or ``"annulus triangles"``. ``error`` is the L2 error of the Poisson problem on the adapted
    mesh, ``uniform_error`` that on the uniform one; None for programs that solve nothing. ``read`` says whether nodes,
    area and orientation arrived, ``tags`` whether the four sides did.
    """

    consumer: str
    version: str
    format: str
    mesh: str
    error: float | None
    uniform_error: float | None
    read: bool
    tags: bool


def write(record: Record) -> Path:
    """The file of the record; it replaces an earlier one of the same consumer, format and mesh."""
    name = "-".join(re.sub(r"\W+", "_", word) for word in (record.consumer, record.format, record.mesh))
    RECORDS.mkdir(parents=True, exist_ok=True)
    part = RECORDS / f".{name}.part"
    part.write_text(json.dumps(asdict(record)) + "\n")
    return part.replace(RECORDS / f"{name}.json")


def read_all() -> list[Record]:
    """All records that runs have left, by consumer, format and mesh."""
    found = [Record(**json.loads(path.read_text())) for path in RECORDS.glob("*.json")]
    return sorted(found, key=lambda record: (record.consumer.lower(), record.format, record.mesh))
