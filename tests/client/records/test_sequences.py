"""Sequences in a list."""

from __future__ import annotations

from equimesh_client import SequenceRecord


def test_a_sequence_of_a_list() -> None:
    mesh = {"id": "m-1", "status": "succeeded", "certificate": {"status": "relaxed", "warnings": ["a warning"]}}
    record = {"id": "q-1", "step": 3, "keep": 2, "created_at": "2026-01-01", "used_at": "2026-01-02", "mesh": mesh}
    found = SequenceRecord.from_json(record)
    assert (found.id, found.number, found.mesh_id, found.status, found.keep) == ("q-1", 3, "m-1", "succeeded", 2)
    assert found.warnings == ("a warning",)
    begun = SequenceRecord.from_json({**record, "mesh": {"id": "m-1", "status": "running", "certificate": None}})
    assert (begun.status, begun.certificate, begun.warnings) == ("running", None, ())
