"""Secrets of keys."""

from __future__ import annotations

import re
import sqlite3
from pathlib import Path

from equimesh_service import Settings
from equimesh_service.store.store import Store


def test_the_secret_is_not_on_disk(tmp_path: Path) -> None:
    store = Store(Settings(data_dir=tmp_path).database)
    store.prepare()
    row, secret = store.keys.create("ada", ["read"])
    store.close()
    sqlite3.connect(tmp_path / "equimesh.sqlite3").execute("PRAGMA wal_checkpoint").close()
    assert all(secret[-43:].encode() not in file.read_bytes() for file in tmp_path.iterdir())
    assert re.fullmatch(r"[0-9a-f]{64}", row.sha256)
