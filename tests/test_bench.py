"""`benchmarks/bench.py`: its table, its file, and what it refuses. ``test_benchmarks`` tests the measurements."""

from __future__ import annotations

import json
from pathlib import Path

import bench
import pytest
from costs import newton
from costs.rows import Row


def test_the_script_prints_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [Row(what="n = 65, tight", value=300.0, unit="ns/point", goal=400.0, counts={"65": 9})]
    monkeypatch.setattr(bench, "_rows", {bench.QUICK: rows}.__getitem__)
    file = tmp_path / "bench.json"
    bench.main(["--quick", "--json", str(file)])
    printed = capsys.readouterr().out
    assert "300 ns/point       <= 400   met      65: 9" in printed
    assert ("not installed" in printed) != newton.has_pardiso()
    written = json.loads(file.read_text())
    assert (written["rows"], written["peers"]) == ([rows[0].plain()], [])


def test_a_missing_folder_is_refused_before_any_work(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        bench.main(["--json", str(tmp_path / "none" / "bench.json")])
    assert ended.value.code == 2
    assert "there is no such folder" in capsys.readouterr().err
