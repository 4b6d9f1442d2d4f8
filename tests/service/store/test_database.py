"""How SQLite and PostgreSQL are used: what is on disk when a write returns."""

from __future__ import annotations

import os
import re
import sqlite3
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from sqlalchemy import bindparam, create_engine, delete, event, insert, make_url, select, text
from sqlalchemy.exc import DBAPIError, IntegrityError, OperationalError

from equimesh_cli import main
from equimesh_service import Settings, running
from equimesh_service.errors import UnusableDatabaseError
from equimesh_service.store import database
from equimesh_service.store.blobs import insert_blob
from equimesh_service.store.prepared import Prepared
from equimesh_service.store.schema import blobs, samples
from equimesh_service.store.store import Store
from service.databases import Postgres


def test_sqlite_writes_ahead_and_to_disk(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    with store.database.read() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2
        assert connection.execute(text("PRAGMA foreign_keys")).scalar() == 1
    store.close()


def test_the_pages_of_a_deleted_file_are_not_written_once_more(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    store.prepare()
    log, content = tmp_path / "test.sqlite3-wal", bytes(200_000)
    insert_blob(store.database, "f" * 64, content)
    before = log.stat().st_size
    with store.database.write() as connection:
        assert connection.execute(delete(blobs)).rowcount == 1
    assert before > len(content)
    assert log.stat().st_size - before < len(content) / 4
    store.close()


def test_one_transaction_after_another_uses_the_same_connection(tmp_path: Path) -> None:
    store, used = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}"), set[int]()
    with store.database.read(), store.database.read():
        pass  # now there are two
    for _ in range(4):
        with store.database.write() as connection:
            used.add(id(connection.connection.dbapi_connection))
    assert len(used) == 1
    store.close()


def test_a_service_waits_while_another_one_prepares_the_same_new_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = sqlite3.connect(tmp_path / "test.sqlite3", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    waits: list[float] = []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 3:
            other.execute("COMMIT")

    monkeypatch.setattr(database, "time", SimpleNamespace(**{**vars(time), "sleep": wait}))  # in this module alone
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    with store.database.read() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
    assert len(waits) == 3
    store.close()
    other.close()


def test_a_database_that_takes_no_writes_is_noticed_though_it_can_be_read(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    store.prepare()
    store.check()
    store.close()
    event.listen(store.database._engine, "connect", lambda raw, _: raw.execute("PRAGMA query_only = ON"))
    with store.database.read() as connection:
        assert connection.execute(text("SELECT count(*) FROM meshes")).scalar() == 0
    with pytest.raises(OperationalError, match="readonly database"):
        store.check()
    store.close()


def test_a_server_that_is_set_to_take_no_writes_is_noticed(postgres: Postgres) -> None:
    with postgres.database() as url:
        store = Store(url)
        store.prepare()
        store.check()
        store.close()
        options = str(make_url(url).query["options"])
        address = make_url(url).update_query_dict({"options": f"{options} -cdefault_transaction_read_only=on"})
        read_only = Store(address.render_as_string(hide_password=False))
        with read_only.database.read() as connection:
            assert connection.execute(text("SELECT count(*) FROM meshes")).scalar() == 0
        with pytest.raises(DBAPIError, match="read-only transaction"):
            read_only.check()
        read_only.close()


def test_only_what_is_promised_waits_for_the_disk(store: Store, address: str) -> None:
    query = "PRAGMA synchronous" if address.startswith("sqlite") else "SHOW synchronous_commit"
    waits, goes_on = (2, 1) if address.startswith("sqlite") else ("on", "off")
    for durable, expected in ((True, waits), (False, goes_on), (True, waits)):
        with store.database.write(durable=durable) as connection:
            assert connection.execute(text(query)).scalar() == expected


def test_a_service_does_not_start_without_its_database(tmp_path: Path) -> None:
    url = f"postgresql+psycopg://user:hunter2@/nothing?host={tmp_path}"
    settings = Settings(data_dir=tmp_path, database_url=url, port=0)  # type: ignore[arg-type]
    with pytest.raises(UnusableDatabaseError, match="the database does not answer") as caught, running(settings):
        raise AssertionError
    assert "hunter2" not in str(caught.value)


def test_a_database_that_is_not_in_utf8_is_refused(
    postgres: Postgres, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"equimesh_ascii_{os.getpid()}"
    address = make_url(postgres.url).set(database=name).render_as_string(hide_password=False)
    server = create_engine(postgres.url, isolation_level="AUTOCOMMIT")
    with server.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name} TEMPLATE template0 ENCODING 'SQL_ASCII' LOCALE 'C'"))
    try:
        wanted = r"the database is in SQL_ASCII, and equimesh needs UTF8: create one with `createdb .*`$"
        settings = Settings(data_dir=tmp_path, database_url=address, port=0)  # type: ignore[arg-type]
        with pytest.raises(UnusableDatabaseError, match=wanted), running(settings):
            raise AssertionError
        assert main(["database", "current", "--database-url", address]) == 2
        assert re.match(f"equimesh: {wanted}", capsys.readouterr().err)
    finally:
        with server.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name}"))
        server.dispose()


def test_a_prepared_statement_takes_and_finds_what_sqlalchemy_would(store: Store) -> None:
    row = {"sha256": "a" * 64, "size": 2**40, "summary": {"kind": "grid", "min": None}, "created_at": 0.1, "used_at": 2}
    with store.database.write() as connection:
        insertion = Prepared(insert(samples))
        insertion.execute(connection, {"id": "s-\x001", **row}, {"id": "s-2", **row})
        insertion.execute(connection, {**row, "id": "s-3"})  # another order of the names
        kept = connection.execute(select(samples).order_by(samples.c.id)).all()
        assert [one.id for one in kept] == ["s-2", "s-3", "s-\ufffd1"]
        assert all(one[1:] == tuple(row.values()) for one in kept)
        found = Prepared(
            select(samples.c.id).where(samples.c.size == 2**40, samples.c.id == bindparam("name")).limit(1)
        )
        assert found.execute(connection, {"name": "s-\x001"}).scalar() == "s-\ufffd1"
        assert not found.execute(connection, {"name": "s-4"}).all()
        assert database.insert_new(connection, samples, {**row, "id": "s-4"})
        assert not database.insert_new(connection, samples, {**row, "id": "s-4", "size": 1})
        with pytest.raises(IntegrityError), connection.begin_nested():
            insertion.execute(connection, {"id": "s-2", **row})


def test_a_write_that_a_read_only_database_refuses_is_told_as_that(tmp_path: Path) -> None:
    """The connection is given up then, with the cursors of it: to close one of them is an error."""
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    store.prepare()
    row = {"id": "s-1", "sha256": "a" * 64, "size": 1, "summary": {}, "created_at": 0.0, "used_at": 0.0}

    def write(first: str) -> None:
        with store.database.write() as connection:
            connection.execute(text(first))
            Prepared(insert(samples)).execute(connection, row)

    with pytest.raises(OperationalError, match="readonly"):
        write("PRAGMA query_only = ON")
    write("SELECT 1")
    store.close()


def test_a_deleted_mesh_looks_for_its_keys_by_an_index(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'test.sqlite3'}")
    store.prepare()
    with store.database.read() as connection:
        (plan,) = connection.execute(text("EXPLAIN QUERY PLAN SELECT key FROM idempotency WHERE mesh_id = 'm-1'")).all()
    assert "USING INDEX ix_idempotency_mesh_id" in plan.detail
    store.close()
