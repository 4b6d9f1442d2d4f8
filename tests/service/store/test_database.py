"""How SQLite and PostgreSQL are used: what is on disk when a write returns."""

from __future__ import annotations

from pathlib import Path

import pytest
from sqlalchemy import text

from equimesh_service import Settings, running
from equimesh_service.errors import UnusableDatabaseError
from equimesh_service.store.store import Store


def test_sqlite_writes_ahead_and_to_disk(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    with store.database.read() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2
        assert connection.execute(text("PRAGMA foreign_keys")).scalar() == 1
    store.close()


def test_only_what_is_promised_waits_for_the_disk(store: Store, address: str) -> None:
    query = "PRAGMA synchronous" if address.startswith("sqlite") else "SHOW synchronous_commit"
    waits, goes_on = (2, 1) if address.startswith("sqlite") else ("on", "off")
    hasty = Store(address, durable=False)
    for one, durable, expected in ((store, True, waits), (store, False, goes_on), (store, True, waits)):
        with one.database.write(durable=durable) as connection:
            assert connection.execute(text(query)).scalar() == expected
    with hasty.database.write() as connection:
        assert connection.execute(text(query)).scalar() == goes_on
    hasty.close()


def test_a_service_does_not_start_without_its_database(tmp_path: Path) -> None:
    url = f"postgresql+psycopg://user:hunter2@/nothing?host={tmp_path}"
    settings = Settings(data_dir=tmp_path, database_url=url, port=0)  # type: ignore[arg-type]
    with pytest.raises(UnusableDatabaseError, match="the database does not answer") as caught, running(settings):
        raise AssertionError
    assert "hunter2" not in str(caught.value)
