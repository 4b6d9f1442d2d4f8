"""Checks of where a service keeps its data."""

from __future__ import annotations

import errno
import shutil
import socket
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from sqlalchemy import create_engine, insert, text

from cli.conftest import look
from equimesh_cli.checks import installation
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.store.database import upgrade
from equimesh_service.store.schema import meshes, samples
from service.databases import Postgres
from service.s3_server import ACCESS_KEY, SECRET_KEY, serving
from service.store.first_release import FIRST, MESH

OK = Level.OK
WARNING = Level.WARNING
FAILED = Level.FAILED
pytestmark = pytest.mark.usefixtures("no_variables")


def test_a_network_file_system(here: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(
        f"22 1 8:1 / / rw - ext4 /dev/sda1 rw\n23 22 0:44 / {tmp_path} rw shared:1 - nfs4 server:/export rw\n"
    )
    monkeypatch.setattr(installation, "MOUNTS", mounts)
    assert look(installation.folder, here).level is FAILED
    assert (
        look(
            installation.folder,
            here.model_copy(update={"database_url": Settings(database_url="postgresql://h/n").database_url}),
        ).level
        is OK
    )
    mounts.write_text(mounts.read_text().replace("nfs4", "xfs"))
    assert look(installation.folder, here).level is OK


@pytest.mark.parametrize(("free", "level"), [(10**7, FAILED), (10**9, WARNING), (10**11, OK)])
def test_a_full_disk(free: int, level: Level, here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert look(installation.disk, here).level is level


def test_a_read_only_folder(made: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    assert look(installation.files, made).level is OK
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    for check in (installation.folder, installation.files):
        found = look(check, made)
        assert found.level is FAILED
        assert "Read-only file system" in found.message


def test_revisions_of_a_database(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url)
    engine = create_engine(database_url)
    assert look(installation.database, settings).level is OK
    assert installation.clock(settings) is None
    FIRST.create_all(engine)
    found = look(installation.database, settings)
    assert (found.level, "revision 0001" in found.message) == (WARNING, True)
    upgrade(database_url)
    assert look(installation.database, settings).level is OK
    with engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    found = look(installation.database, settings)
    assert (found.level, "newer release" in found.message) == (FAILED, True)
    engine.dispose()


def test_a_damaged_database(made: Settings) -> None:
    file = made.data_dir / "equimesh.sqlite3"
    content = bytearray(file.read_bytes())
    content[-2 * 4096 :] = b"\x07" * 2 * 4096
    file.write_bytes(content)
    assert look(installation.database, made).level is FAILED


def test_a_database_that_does_not_answer() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        settings = Settings(database_url=f"postgresql://ada:hidden@127.0.0.1:{port}/meshes")
        for check in (installation.database, installation.clock):
            found = look(check, settings)
            assert found.level is FAILED
            assert "does not answer" in found.message
            assert "hidden" not in found.message


@pytest.mark.parametrize(("seconds", "level"), [(1.0, OK), (8.0, WARNING), (3600.0, WARNING)])
def test_clocks_that_differ(
    seconds: float, level: Level, postgres: Postgres, made: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = create_engine(made.database)
    with engine.begin() as connection:
        row = {**MESH, "id": "m", "status": "queued", "created_at": time.time() + seconds}
        connection.execute(insert(meshes).values(row))
    engine.dispose()
    assert look(installation.clock, made).level is level
    with postgres.database() as url:
        upgrade(url)
        now = time.time
        monkeypatch.setattr(time, "time", lambda: now() + seconds)
        assert look(installation.clock, Settings(database_url=url)).level is level


def test_files_in_s3(tmp_path: Path) -> None:
    (tmp_path / "s3").mkdir()
    with serving(tmp_path / "s3") as server:
        bucket = server.bucket("meshes")
        given = {"s3_endpoint": server.endpoint, "s3_access_key": ACCESS_KEY, "s3_secret_key": SECRET_KEY}
        settings = Settings(data_dir=tmp_path / "data", files_url="s3://meshes", **given)  # type: ignore[arg-type]
        assert look(installation.files, settings).level is OK
        assert not list(bucket.rglob("*"))
        other = settings.model_copy(update={"files_url": "s3://others"})
        assert look(installation.files, other).level is FAILED
    assert look(installation.files, settings.model_copy(update={"files_url": "ftp://h"})).level is FAILED
    assert not (tmp_path / "data").exists()


def test_files_that_the_database_names_and_are_lost(made: Settings) -> None:
    kept = made.data_dir / "files" / "ab" / ("ab" * 32)
    row = {"id": "s", "sha256": kept.name, "size": 5, "summary": {}, "created_at": 1.0, "used_at": 1.0}
    engine = create_engine(made.database)
    with engine.begin() as connection:
        connection.execute(insert(samples).values(row))
    engine.dispose()
    assert look(installation.stored_files, made).level is FAILED
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"12345")
    assert look(installation.stored_files, made).level is OK
    kept.write_bytes(b"123")
    assert "1 are damaged" in look(installation.stored_files, made).message
