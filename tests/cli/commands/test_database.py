"""`equimesh database`: the revision, the upgrade and the copy of a database, for people and as JSON."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from equimesh_cli import main
from equimesh_service.store.database import LATEST

pytestmark = pytest.mark.usefixtures("no_variables")


def test_from_no_tables_to_a_copy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "copy.sqlite3"

    def database(action: str, *words: str) -> tuple[int, str, Any]:
        """The exit code, the sentence of one call, and the JSON of the next, if both succeed."""
        command = ["database", action, *words, "--data-dir", str(tmp_path / "data")]
        code = main(command)
        captured = capsys.readouterr()
        return code, captured.out + captured.err, main([*command, "--json"]) or json.loads(capsys.readouterr().out)

    missing = database("current")
    assert (missing[0], missing[2]) == (0, {"current": None, "latest": LATEST})
    assert missing[1].startswith("no tables yet")
    assert not (tmp_path / "data").exists()
    assert database("upgrade") == (0, f"the database has revision {LATEST}\n", {"current": LATEST})
    assert database("current") == (0, f"{LATEST}\n", {"current": LATEST, "latest": LATEST})
    assert main(["database", "backup", str(copy), "--data-dir", str(tmp_path / "data")]) == 0
    assert capsys.readouterr().out.startswith(f"wrote {copy}, {copy.stat().st_size} bytes")
    with sqlite3.connect(copy) as connection:
        assert connection.execute("select count(*) from meshes").fetchone() == (0,)
    connection.close()
    assert main(["database", "backup", str(copy), "--data-dir", str(tmp_path / "data")]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_database_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "equimesh.sqlite3").write_text("not a database " * 100)
    assert main(["database", "current", "--data-dir", str(tmp_path)]) == 3
    assert "the database does not answer (DatabaseError)" in capsys.readouterr().err
