"""The list of the files of a mesh in parts."""

from __future__ import annotations

from typing import Any

from equimesh_client import FileOfParts, PartRecord, Parts

FILE: dict[str, Any] = {"name": "m/part-0000.vtu", "media_type": "x/y", "size": 7, "sha256": "ab", "href": "/x"}
RECORD: dict[str, Any] = {
    "format": "pvtu",
    "formats": ["pvtu", "npz"],
    "grid": {"n_xi": 5, "n_eta": 4},
    "size": None,
    "head": {**FILE, "name": "m.pvtu", "size": None, "sha256": None},
    "parts": [{"number": 0, "first": 0, "last": 2, "rows": 3, "file": FILE}],
}


def test_the_record_of_a_service() -> None:
    parts = Parts.from_json(RECORD)
    assert (parts.count, parts.grid, parts.formats, parts.size) == (1, (5, 4), ("pvtu", "npz"), None)
    file = FileOfParts(name="m/part-0000.vtu", media_type="x/y", size=7, sha256="ab")
    assert parts.parts == (PartRecord(number=0, first=0, last=2, rows=3, file=file),)
    assert parts.head == FileOfParts(name="m.pvtu", media_type="x/y", size=None, sha256=None)
    assert Parts.from_json({**RECORD, "head": None, "size": 9}).head is None
