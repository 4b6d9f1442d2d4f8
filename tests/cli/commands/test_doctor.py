"""`equimesh doctor`: finds nothing where all is well, and every check can fail."""

from __future__ import annotations

import errno
import importlib.metadata
import json
import os
import platform
import shutil
import socket
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from numba.core.caching import CompileResultCacheImpl
from sqlalchemy import create_engine, insert, text

import equimesh
from equimesh_cli import main
from equimesh_cli.checks import installation, machine, reach, storage
from equimesh_cli.checks.findings import Finding, Level
from equimesh_cli.commands import doctor
from equimesh_client import Client
from equimesh_service import Settings
from equimesh_service.store.migration import upgrade
from equimesh_service.store.schema import meshes, samples
from equimesh_service.store.store import Store
from service.databases import ADDRESS, NEEDED, Postgres
from service.guarded import Guarded
from service.s3_server import ACCESS_KEY, SECRET_KEY, serving
from service.store.first_release import FIRST, MESH

OK, WARNING, FAILED = Level.OK, Level.WARNING, Level.FAILED


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.upper().startswith("EQUIMESH_")]:
        if name not in (ADDRESS, NEEDED):
            monkeypatch.delenv(name)


@pytest.fixture
def here(tmp_path: Path) -> Settings:
    """Settings whose data folder is not there yet."""
    return Settings(data_dir=tmp_path / "data", port=0, workers=1)


@pytest.fixture
def made(here: Settings) -> Settings:
    """Settings with a database."""
    here.data_dir.mkdir()
    upgrade(here.database)
    return here


def look(check: Callable[[Any], Finding | None], subject: Any) -> Finding:
    found = doctor._tried(check, subject)
    assert found is not None
    return found


def test_all_is_well_here_and_nothing_is_left_behind(
    here: Settings, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (ADDRESS, NEEDED):  # no settings, but of the tests
        monkeypatch.delenv(name, raising=False)
    words = ["doctor", "--data-dir", str(here.data_dir), "--port", "0", "--workers", "1", "--memory-limit", "16"]
    assert main([*words, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert [check["check"] for check in said["checks"]] == [name for name in doctor.HERE if name != "clock"]
    assert {check["check"] for check in said["checks"] if check["level"] != "ok"} <= {"disk"}
    assert not here.data_dir.exists()


def test_what_fails_is_said_with_a_remedy(
    here: Settings, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "HERE", {"folder": storage.folder, "exposure": reach.exposure})
    here.data_dir.write_text("a file")
    words = ["doctor", "--data-dir", str(here.data_dir), "--host", "0.0.0.0", "--allow-anonymous", "true"]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert said.startswith(f"failed   folder       the data folder {here.data_dir} cannot be written to: Not a dir")
    assert "\n                      -> give it to the user of the service, or choose another" in said
    assert said.endswith("\n2 checks: 1 failed, 1 with a warning\n")


def test_a_python_that_is_too_old(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "python_version", lambda: "3.10.9")
    assert look(installation.python, here).level is FAILED


def test_packages_that_the_settings_need(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version

    def version(name: str) -> str:
        if name in ("psycopg", "obstore", "opentelemetry-sdk"):
            raise importlib.metadata.PackageNotFoundError(name)
        return "1.0" if name == "sqlalchemy" else real(name)

    assert look(installation.packages, here).level is OK
    monkeypatch.setattr(importlib.metadata, "version", version)
    assert look(installation.packages, here).said == "sqlalchemy is 1.0, and <2.2,>=2.0.30 is needed"
    more = {"database_url": "postgresql://h/n", "files_url": "s3://b", "trace_endpoint": "http://h"}
    found = look(installation.packages, Settings(**more))  # type: ignore[arg-type]
    assert all(f"{name} is not installed" in found.said for name in ("psycopg", "obstore", "opentelemetry-sdk"))
    assert found.remedy == "pip install 'equimesh[service,postgres,s3,tracing]'"


def test_a_misspelled_variable(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_DATADIR", "x")
    found = look(installation.variables, here)
    assert found.level is WARNING
    assert "did you mean EQUIMESH_DATA_DIR?" in found.said


def test_no_folder_for_compiled_loops(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    found = look(installation.kernels, here)
    assert found.level is WARNING
    assert "NUMBA_CACHE_DIR" in found.remedy


def test_a_solver_that_makes_another_mesh(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    real = equimesh.ArcLength
    monkeypatch.setattr(equimesh, "ArcLength", lambda **given: real(**{**given, "a": 0.6}))
    found = look(installation.solve, here)
    assert found.level is FAILED
    assert "1.1979" in found.said


def groups(folder: Path, monkeypatch: pytest.MonkeyPatch, own: str, **files: str) -> None:
    """Control groups: ``own`` is what the system says of this process's, ``files`` are theirs."""
    (folder / "own").write_text(own)
    for name, content in files.items():
        path = folder / "groups" / name.replace("__", "/").replace("_DOT_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    monkeypatch.setattr(machine, "OWN_GROUP", folder / "own")
    monkeypatch.setattr(machine, "CGROUPS", folder / "groups")


def test_limits_of_a_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"a__b__memory_DOT_max": "max\n", "a__memory_DOT_max": "2147483648\n", "a__cpu_DOT_max": "150000 100000"}
    groups(tmp_path, monkeypatch, "0::/a/b\n", **limits)
    assert (machine.allowed_memory(), machine.allowed_processors()) == (2 * 1024**3, 1.5)
    monkeypatch.setattr("equimesh.numerics.threads.available_cores", lambda: 8)
    two = Settings(workers=2, threads=1, memory_limit=4096)
    assert look(machine.processors, two).remedy.endswith("EQUIMESH_WORKERS=1")
    assert look(machine.memory, two).level is WARNING
    assert "this container has 2048 MiB" in look(machine.memory, two).said
    assert look(machine.memory, Settings(workers=2, memory_limit=768)).level is OK
    assert look(machine.memory, Settings(workers=13, memory_limit=16)).level is FAILED
    assert look(machine.processors, Settings(workers=1, threads=4)).level is WARNING
    assert look(machine.processors, Settings(workers=1, threads=1)).level is OK


def test_limits_of_an_older_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = "4:memory:/host/path\n3:cpu,cpuacct:/host/path\n"
    limits = {"memory__memory_DOT_limit_in_bytes": "1073741824", "cpu,cpuacct__cpu_DOT_cfs_quota_us": "200000"}
    groups(tmp_path, monkeypatch, own, **limits)
    assert (machine.allowed_memory(), machine.allowed_processors()) == (1024**3, 2.0)
    groups(tmp_path, monkeypatch, own, memory__memory_DOT_limit_in_bytes=str((1 << 63) - 4096))
    assert machine.allowed_memory() is None


def test_a_network_file_system(here: Settings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mounts = tmp_path / "mounts"
    mounts.write_text(
        f"22 1 8:1 / / rw - ext4 /dev/sda1 rw\n23 22 0:44 / {tmp_path} rw shared:1 - nfs4 server:/export rw\n"
    )
    monkeypatch.setattr(storage, "MOUNTS", mounts)
    assert look(storage.folder, here).level is FAILED
    assert (
        look(
            storage.folder,
            here.model_copy(update={"database_url": Settings(database_url="postgresql://h/n").database_url}),
        ).level
        is OK
    )
    mounts.write_text(mounts.read_text().replace("nfs4", "xfs"))
    assert look(storage.folder, here).level is OK


@pytest.mark.parametrize(("free", "level"), [(10**7, FAILED), (10**9, WARNING), (10**11, OK)])
def test_a_full_disk(free: int, level: Level, here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert look(storage.disk, here).level is level


def test_a_read_only_folder(made: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(**_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    assert look(storage.files, made).level is OK
    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    for check in (storage.folder, storage.files):
        found = look(check, made)
        assert found.level is FAILED
        assert "Read-only file system" in found.said


def test_revisions_of_a_database(database_url: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=database_url)
    engine = create_engine(database_url)
    assert look(storage.database, settings).level is OK
    assert storage.clock(settings) is None
    FIRST.create_all(engine)
    found = look(storage.database, settings)
    assert (found.level, "of revision 0001" in found.said) == (WARNING, True)
    upgrade(database_url)
    assert look(storage.database, settings).level is OK
    with engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    found = look(storage.database, settings)
    assert (found.level, "newer release" in found.said) == (FAILED, True)
    engine.dispose()


def test_a_damaged_database(made: Settings) -> None:
    file = made.data_dir / "equimesh.sqlite3"
    content = bytearray(file.read_bytes())
    content[-2 * 4096 :] = b"\x07" * 2 * 4096
    file.write_bytes(content)
    assert look(storage.database, made).level is FAILED


def test_a_database_that_does_not_answer() -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        port = nobody.getsockname()[1]
        settings = Settings(database_url=f"postgresql://ada:hidden@127.0.0.1:{port}/meshes")
        for check in (storage.database, storage.clock):
            found = look(check, settings)
            assert found.level is FAILED
            assert "does not answer" in found.said
            assert "hidden" not in found.said


@pytest.mark.parametrize(("seconds", "level"), [(1.0, OK), (8.0, WARNING), (60.0, FAILED)])
def test_clocks_that_differ(
    seconds: float, level: Level, postgres: Postgres, made: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = create_engine(made.database)
    with engine.begin() as connection:
        row = {**MESH, "id": "m", "status": "queued", "created_at": time.time() + seconds}
        connection.execute(insert(meshes).values(row))
    engine.dispose()
    assert look(storage.clock, made).level is level
    with postgres.database() as url:
        upgrade(url)
        now = time.time
        monkeypatch.setattr(time, "time", lambda: now() + seconds)
        assert look(storage.clock, Settings(database_url=url)).level is level


def test_files_in_s3(tmp_path: Path) -> None:
    (tmp_path / "s3").mkdir()
    with serving(tmp_path / "s3") as server:
        bucket = server.bucket("meshes")
        given = {"s3_endpoint": server.endpoint, "s3_access_key": ACCESS_KEY, "s3_secret_key": SECRET_KEY}
        settings = Settings(data_dir=tmp_path / "data", files_url="s3://meshes", **given)  # type: ignore[arg-type]
        assert look(storage.files, settings).level is OK
        assert not list(bucket.rglob("*"))
        other = settings.model_copy(update={"files_url": "s3://others"})
        assert look(storage.files, other).level is FAILED
    assert look(storage.files, settings.model_copy(update={"files_url": "ftp://h"})).level is FAILED
    assert not (tmp_path / "data").exists()


def test_files_that_the_database_names_and_are_lost(made: Settings) -> None:
    kept = made.data_dir / "files" / "ab" / ("ab" * 32)
    row = {"id": "s", "sha256": kept.name, "size": 5, "summary": {}, "created_at": 1.0, "used_at": 1.0}
    engine = create_engine(made.database)
    with engine.begin() as connection:
        connection.execute(insert(samples).values(row))
    engine.dispose()
    assert look(storage.stored, made).level is FAILED
    kept.parent.mkdir(parents=True)
    kept.write_bytes(b"12345")
    assert look(storage.stored, made).level is OK
    kept.write_bytes(b"123")
    assert "1 are damaged" in look(storage.stored, made).said


def test_a_port_that_is_taken(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ours = int(url.rpartition(":")[2])
    assert look(reach.port, Settings(port=ours)).said.startswith("a service of equimesh answers")
    monkeypatch.setattr(reach, "TIMEOUT_SECONDS", 0.5)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        found = look(reach.port, Settings(port=other.getsockname()[1]))
    assert (found.level, "another program" in found.said) == (FAILED, True)
    assert look(reach.port, Settings(port=0)).level is OK
    assert look(reach.port, Settings(host="192.0.2.1", port=0)).level is FAILED


def test_an_address_of_others_without_a_key(made: Settings) -> None:
    public = made.model_copy(update={"host": "0.0.0.0"})
    assert look(reach.exposure, public).level is FAILED
    assert look(reach.exposure, public.model_copy(update={"allow_anonymous": True})).level is WARNING
    assert look(reach.exposure, made).level is OK
    store = Store(made.database)
    store.keys.create("test", ["read"])
    store.close()
    assert look(reach.exposure, public).level is OK


def test_a_service_that_runs(
    url: str, guarded_service: Guarded, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It alone is looked at, and not this machine."""

    def ask(url: str, key: str = "") -> tuple[int, dict[str, str]]:
        code = main(["doctor", "--json", "--url", url, "--key", key])
        return code, {check["check"]: check["level"] for check in json.loads(capsys.readouterr().out)["checks"]}

    assert ask(url) == (0, dict.fromkeys(doctor.THERE, "ok"))
    with Client(url, key="") as client:
        assert not [mesh for mesh in client.meshes.list() if mesh.record["label"] == "doctor"]
    well = {"ready": "ok", "version": "ok"}
    assert ask(guarded_service.url, guarded_service.key("write")[1])[0] == 0
    assert ask(guarded_service.url) == (1, {**well, "key": "failed", "round trip": "warning"})
    reader = ask(guarded_service.url, guarded_service.key("read")[1])
    assert reader == (0, {**well, "key": "ok", "round trip": "warning"})
    monkeypatch.setattr(reach.importlib.metadata, "version", lambda _: "9.9")
    assert ask(url)[1]["version"] == "warning"


@pytest.mark.parametrize("words", [["--stored"], ["--workers", "2"]])
def test_a_service_elsewhere_or_this_machine(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--url", "http://127.0.0.1:9", *words]) == 2
    assert "leave out one of them" in capsys.readouterr().err


def test_a_service_that_does_not_run(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))
        assert main(["doctor", "--url", f"http://127.0.0.1:{nobody.getsockname()[1]}"]) == 1
    assert "does not answer (ConnectError)\n" in capsys.readouterr().out
