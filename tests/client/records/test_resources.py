"""The list of the files of a mesh in parts."""

from __future__ import annotations

from typing import Any

import pytest

from equimesh_client import FileOfParts, PartRecord, Parts, Progress
from equimesh_client.records.resources import MeshState, progress_of

FILE: dict[str, Any] = {"name": "m/part-0000.vtu", "media_type": "x/y", "size": 7, "sha256": "ab", "href": "/x"}
RECORD: dict[str, Any] = {
    "id": "m-1",
    "count": 1,
    "format": "pvtu",
    "formats": ["pvtu", "npz"],
    "grid": {"n_xi": 5, "n_eta": 4},
    "size": None,
    "head": {**FILE, "name": "m.pvtu", "size": None, "sha256": None},
    "parts": [{"number": 0, "first": 0, "last": 2, "rows": 3, "file": FILE}],
}


def test_the_record_of_a_service() -> None:
    parts = Parts.from_json(RECORD)
    assert (parts.count, tuple(parts.grid), parts.formats, parts.size) == (1, (5, 4), ("pvtu", "npz"), None)
    file = FileOfParts(name="m/part-0000.vtu", media_type="x/y", size=7, sha256="ab", href="/x")
    assert parts.parts == (PartRecord(number=0, first=0, last=2, rows=3, file=file),)
    assert parts.head == FileOfParts(name="m.pvtu", media_type="x/y", size=None, sha256=None, href="/x")
    assert Parts.from_json({**RECORD, "head": None, "size": 9}).head is None


# The state and the progress of a mesh, read from its resource.


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        ({"status": "queued"}, Progress(stage="queued")),
        ({"status": "running", "progress": "lost"}, Progress(stage="running")),
        (
            {"status": "running", "progress": {"stage": "schwarz", "iteration": 3, "residual": 1e-4, "fraction": 0.5}},
            Progress(stage="schwarz", iteration=3, residual=1e-4, fraction=0.5),
        ),
        ({"status": "running", "progress": {"iteration": "3", "fraction": 7}}, Progress(stage="running", fraction=1.0)),
        ({"status": "succeeded", "progress": {"fraction": 0.9}}, Progress(stage="succeeded", fraction=1.0)),
    ],
)
def test_progress_of_a_record(record: dict[str, Any], expected: Progress) -> None:
    assert progress_of(record) == expected


def test_a_record_without_optional_keys() -> None:
    state = MeshState({"id": "m-1"})
    assert (state.id, state.status, state.is_finished, state.attempts) == ("m-1", "queued", False, 0)
    assert (state.label, state.error, state.reused_from, state.certificate) == (None, None, None, None)
    assert (state.relaxed, state.warnings, state.timings) == (False, (), {})
    assert repr(state) == "<MeshState m-1 queued>"


def test_the_certificate_of_a_finished_mesh() -> None:
    certificate = {
        "status": "relaxed",
        "warnings": ["coarse"],
        "relaxed": [{"what": "a", "asked": 0.9, "reached": 0.5}],
    }
    state = MeshState({"id": "m-1", "status": "succeeded", "reused_from": "m-0", "certificate": certificate})
    assert (state.is_finished, state.relaxed, state.warnings, state.reused_from) == (True, True, ("coarse",), "m-0")
    assert [part.reached for part in state.certificate.relaxed] == [0.5] if state.certificate else False


def test_a_relaxed_mesh_says_so(connect: Any, service: Any) -> None:
    client = connect(service.url)
    plain = client.generate("x", 8)
    assert (plain.certificate, plain.relaxed, plain.warnings) == (None, False, ())
    mesh = client.generate("x", 8, label="relaxed")
    assert mesh.relaxed
    assert mesh.warnings == ("The mesh adapts less than requested.",)
    assert mesh.certificate.interpolation_gain == {"l2": 5.4, "h1": 2.4}
    assert (mesh.certificate.relaxed[0].what, mesh.certificate.relaxed[0].reached) == ("a", 0.35)
    assert (mesh.certificate.non_orthogonality, mesh.certificate.mean_non_orthogonality) == (41.7, 16.9)
    assert mesh.certificate.skewness == 0.62
    said = str(mesh.certificate)
    for words in (
        "relaxed",
        "a of the arc length: 0.7 requested, 0.35 reached",
        "5.4 in L2",
        "42 degrees, 17 mean; skewness 0.62",
        "warning: The mesh",
    ):
        assert words in said
