"""Records of answers: meshes, measures and certificates."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest

from equimesh_client import Convergence, FileOfParts, PartRecord, Parts, Progress, Quality, SequenceRecord
from equimesh_client.records.measures import align, number
from equimesh_client.records.resources import MeshState, progress_of


def test_convergence_speaks() -> None:
    rows = [
        {"iteration": 0, "max_q_eq": 2.0, "change": None, "error": 0.1, "subdomains": []},
        {"iteration": 1, "max_q_eq": 1.5, "change": 1e-6, "subdomains": [{"newton_steps": 4}, {"newton_steps": 3}]},
    ]
    convergence = Convergence.from_json({"iterations": rows, "rate": 0.25, "predicted_rate": None})
    lines = str(convergence).splitlines()
    assert lines[0].split() == ["iteration", "max_q_eq", "change", "error", "newton", "steps"]
    assert lines[3].split() == ["1", "1.5000", "1.000e-06", "-", "4+3"]
    assert lines[-1] == "observed rate 0.2500"
    assert np.isnan(convergence.column("error")[1])
    swept = [{"sweeps": 2, "status": "converged"}] * 4 + [{"sweeps": 2, "status": "stalled"}]
    rows[0]["transmission"] = "classical"
    rows[1] |= {"transmission": "optimized", "accelerated": True, "work": 7, "subdomains": swept}
    convergence = Convergence.from_json({"iterations": rows})
    said = str(convergence).splitlines()
    assert said[0].split()[-2:] == ["sweeps", "remark"]
    assert said[3].endswith("5 x 2  optimized took over, 1 stalled, accelerated")
    assert convergence.column("work")[1] == 7
    assert str(Convergence.from_json({})) == "one domain: no Schwarz iteration"


def test_a_descent_is_told_by_the_last_step_on_each_grid() -> None:
    numbers = {"distortion": 0.1, "min_jacobian": 0.5}
    rows = [
        {"level": 0, "grid": [9, 9], "start": "uniform", "step": 1, "error": 0.5, "gain": 1.5, **numbers},
        {"level": 0, "grid": [9, 9], "start": "uniform", "step": 2, "error": 0.25, "gain": 3.0, **numbers},
        {"level": 1, "grid": [17, 9], "start": "uniform", "step": 0, "error": 0.125, "gain": None, **numbers},
    ]
    convergence = Convergence.from_json({"iterations": [], "descent": rows})
    lines = str(convergence).splitlines()
    assert lines[0].split() == ["grid", "start", "step", "error", "gain", "min_jacobian"]
    assert len(lines) == 4
    assert lines[2].split() == ["9", "x", "9", "uniform", "2", "0.2500", "3.0000", "0.5000"]
    assert lines[3].split() == ["17", "x", "9", "uniform", "0", "0.1250", "-", "0.5000"]
    assert convergence.column("error").tolist() == [0.5, 0.25, 0.125]
    assert np.isnan(convergence.column("gain")[2])


# Quality measures, from JSON to a table.


def test_quality_speaks_and_lacks_nothing_it_was_not_given() -> None:
    errors = {"l2": 1e-4, "l2_uniform": 2e-3, "h1": 1.0, "h1_uniform": 2.0}
    q_eq = {"max": 1.6375, "rms": 1.0, "cells": [[1, 2]]}
    quality = Quality.from_json({"q_eq": q_eq, "min_jacobian": 0.1, "interpolation_error": errors, "new": 3})
    assert quality.q_eq.max == 1.6375
    assert np.isnan(quality.q_eq.min)
    assert quality.q_eq.cells.shape == (1, 2)
    with pytest.raises(AttributeError, match="no measure 'q_foo'"):
        _ = quality.q_foo
    assert "1.6375" in str(quality)
    assert "1.000e-04" in str(quality)
    assert str(Quality.from_json({}))
    assert pickle.loads(pickle.dumps(quality)).min_jacobian == 0.1


# Sequences in a list.


def test_a_sequence_of_a_list() -> None:
    mesh = {"id": "m-1", "status": "succeeded", "certificate": {"status": "relaxed", "warnings": ["a warning"]}}
    record = {"id": "q-1", "step": 3, "keep": 2, "created_at": "2026-01-01", "used_at": "2026-01-02", "mesh": mesh}
    found = SequenceRecord.from_json(record)
    assert (found.id, found.number, found.mesh_id, found.status, found.keep) == ("q-1", 3, "m-1", "succeeded", 2)
    assert found.warnings == ("a warning",)
    begun = SequenceRecord.from_json({**record, "mesh": {"id": "m-1", "status": "running", "certificate": None}})
    assert (begun.status, begun.certificate, begun.warnings) == ("running", None, ())


# Tables of text, and the numbers in them.


def test_tables() -> None:
    assert align(["a", "bb"], [["ccc", "1"]]) == "a    bb\n-------\nccc   1"
    cases = {0.0: "0.0000", 1e-3: "0.0010", 9e-4: "9.000e-04", -2e5: "-2.000e+05", np.inf: "inf", np.nan: "-"}
    assert {value: number(value) for value in cases} == cases


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
