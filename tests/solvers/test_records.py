"""Records of consumers are stored one by one, and read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from solvers import records
from solvers.records import Record


def test_records_are_read_back_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "RECORDS", tmp_path / "records")
    first = Record(
        consumer="FiPy", version="4.0", format="msh", mesh="square quads", error=0.1, uniform_error=None, read=True,
        tags=True,
    )  # fmt: skip
    other = replace(first, consumer="deal.II", error=None)
    records.write(first)
    records.write(other)
    assert records.read_all() == [other, first]
    records.write(replace(first, version="4.1"))
    assert [record.version for record in records.read_all()] == ["4.0", "4.1"]
