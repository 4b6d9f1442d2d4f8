"""Databases of older releases are upgraded with all their rows, and newer ones are not touched."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Engine, create_engine, inspect, text

from equimesh_service import Settings, running
from equimesh_service.errors import NewerDatabaseError, UnusableDatabaseError
from equimesh_service.store.database import LATEST, current, upgrade
from equimesh_service.store.schema import metadata
from equimesh_service.store.store import Store
from service.store.first_release import FIRST, MESH, fill


@pytest.fixture
def engine(database_url: str) -> Iterator[Engine]:
    engine = create_engine(database_url)
    yield engine
    engine.dispose()


def test_a_database_of_the_first_release_is_brought_up_to_date(database_url: str, engine: Engine) -> None:
    fill(engine, "4" * 64, 9)
    assert current(database_url) == "0001"
    assert upgrade(database_url) == current(database_url) == LATEST
    with engine.connect() as connection:
        # SQLite reports defaults in another form.
        defaults = connection.dialect.name == "postgresql"
        context = MigrationContext.configure(connection, opts={"compare_server_default": defaults})
        assert compare_metadata(context, metadata) == []
        assert connection.execute(text("SELECT samples_id, key_id, created_at FROM samples_keys")).all() == [
            ("s-1", "", 3.0)
        ]
        assert connection.execute(text("SELECT key_id, key, mesh_id FROM idempotency")).all() == [("", "k", "m-1")]
        sizes = connection.execute(text("SELECT spec_size FROM meshes")).scalars().all()
        assert sizes == [len(MESH["spec"].encode())] * 2
        now = time.time()
        assert connection.execute(text("SELECT used_at FROM samples")).scalar() == pytest.approx(now, abs=60.0)
        assert connection.execute(text("SELECT kept_from FROM meshes")).scalar() == pytest.approx(now, abs=60.0)
    store = Store(database_url)
    assert [(row.id, row.status, row.key_id) for row in store.meshes.page(key_id="")] == [
        ("m-2", "queued", ""),
        ("m-1", "succeeded", ""),
    ]
    assert store.samples.delete("s-1", lambda _: None, "") is False  # m-2 named them in its row
    assert [event.number for event in store.meshes.events("m-1")] == [1]
    assert store.retention.retire_meshes(3600.0, lambda _: None) == 0  # its time begins with this release
    assert store.meshes.delete("m-1", lambda _: None)
    store.close()


def test_a_new_database_is_what_all_steps_together_make(database_url: str, engine: Engine) -> None:
    assert current(database_url) is None
    upgrade(database_url)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
        assert inspect(connection).get_columns("alembic_version")[0]["name"] == "version_num"
    folder = Path(str(import_module("equimesh_service.store.migrations").__file__)).parent
    assert ScriptDirectory(str(folder)).get_heads() == [LATEST]


def test_the_keys_of_a_revision_without_shares_have_equal_ones(database_url: str, engine: Engine) -> None:
    upgrade(database_url)
    with engine.begin() as connection:  # back to revision 0006
        connection.execute(text("DROP TABLE blobs"))
        connection.execute(text("DROP INDEX ix_idempotency_mesh_id"))
        connection.execute(text("DROP INDEX sequences_by_key"))
        connection.execute(text("ALTER TABLE steps DROP COLUMN settings"))
        connection.execute(text("ALTER TABLE keys DROP COLUMN share"))
        connection.execute(text("DROP INDEX meshes_by_status"))
        connection.execute(text("CREATE INDEX meshes_by_status ON meshes (status, number, key_id, n_xi, n_eta)"))
        connection.execute(text("UPDATE alembic_version SET version_num = '0006'"))
        connection.execute(
            text("INSERT INTO keys (id, name, sha256, scopes, created_at) VALUES ('a', 'b', 'c', '[]', 1)")
        )
    upgrade(database_url)
    store = Store(database_url)
    assert [row.share for row in store.keys.list()] == [1]
    store.close()
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []


def test_the_sequences_of_a_revision_without_their_list_are_listed(database_url: str, engine: Engine) -> None:
    upgrade(database_url)
    with engine.begin() as connection:  # back to revision 0007
        connection.execute(text("DROP TABLE blobs"))
        connection.execute(text("DROP INDEX ix_idempotency_mesh_id"))
        connection.execute(text("DROP INDEX sequences_by_key"))
        connection.execute(text("ALTER TABLE steps DROP COLUMN settings"))
        connection.execute(text("UPDATE alembic_version SET version_num = '0007'"))
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) != []
    upgrade(database_url)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), metadata) == []
    store = Store(database_url)
    assert store.sequences.page() == []
    store.close()


@pytest.mark.parametrize("old", [False, True], ids=["new", "old"])
def test_services_that_start_together_change_it_once(database_url: str, engine: Engine, old: bool) -> None:
    if old:
        fill(engine, "4" * 64, 9)
    stores, barrier, failed = [Store(database_url) for _ in range(3)], threading.Barrier(3), []

    def start(store: Store) -> None:
        barrier.wait()
        try:
            store.prepare()
        except Exception as error:
            failed.append(error)

    threads = [threading.Thread(target=start, args=(store,)) for store in stores]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for store in stores:
        store.close()
    assert failed == []
    assert current(database_url) == LATEST
    with engine.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM alembic_version")).scalar() == 1


@pytest.mark.parametrize("revision", ["0011", "0004"])
def test_a_database_of_a_newer_release_is_refused(
    database_url: str, engine: Engine, tmp_path: Path, revision: str
) -> None:
    """Also one of a development version, between the releases."""
    upgrade(database_url)
    with engine.begin() as connection:
        connection.execute(text(f"UPDATE alembic_version SET version_num = '{revision}'"))
    with pytest.raises(NewerDatabaseError, match=r"revision 00\d\d, of a newer release .* restore a backup"):
        upgrade(database_url)
    settings = Settings(data_dir=tmp_path, database_url=database_url, port=0)  # type: ignore[arg-type]
    with pytest.raises(NewerDatabaseError), running(settings):
        raise AssertionError


def test_a_failed_change_leaves_the_old_database(database_url: str, engine: Engine) -> None:
    fill(engine, "4" * 64, 9)
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE retired (id INTEGER)"))  # in the way of the last steps
    with pytest.raises(Exception, match="retired"):
        upgrade(database_url)
    assert current(database_url) == "0001"
    with engine.connect() as connection:
        assert {column["name"] for column in inspect(connection).get_columns("meshes")} == set(
            FIRST.tables["meshes"].columns.keys()
        )


@pytest.mark.parametrize(
    "url", ["", "nonsense", "mysql://u:hunter2@h/n", "sqlite://", "postgresql://u:hunter2@h:port/n"]
)
def test_an_address_that_cannot_be_used_is_told_without_its_password(url: str) -> None:
    with pytest.raises(UnusableDatabaseError, match="addresses are") as caught:
        Store(url)
    assert "hunter2" not in str(caught.value)
