"""Checks of processors and memory, of what is installed, and of a cluster."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from distributed import LocalCluster

import equimesh
from cli.conftest import look
from equimesh.numerics import compiled, machine_code
from equimesh_cli.checks import installation
from equimesh_cli.checks import reach as module
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.engine import examination
from equimesh_service.files.address import files_address
from equimesh_service.settings import SERVICE_MIB
from equimesh_service.worker.job import Storage
from equimesh_service.worker.reach import MARK, Reach

OK = Level.OK
WARNING = Level.WARNING
FAILED = Level.FAILED
pytestmark = pytest.mark.usefixtures("no_variables")


def groups(folder: Path, monkeypatch: pytest.MonkeyPatch, own: str, **files: str) -> None:
    """Control groups: ``own`` is what the system says of this process's, ``files`` are theirs."""
    (folder / "own").write_text(own)
    for name, content in files.items():
        path = folder / "groups" / name.replace("__", "/").replace("_DOT_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    monkeypatch.setattr(installation, "OWN_GROUP", folder / "own")
    monkeypatch.setattr(installation, "CGROUPS", folder / "groups")


def test_limits_of_a_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"a__b__memory_DOT_max": "max\n", "a__memory_DOT_max": "2147483648\n", "a__cpu_DOT_max": "150000 100000"}
    groups(tmp_path, monkeypatch, "0::/a/b\n", **limits)
    assert (installation.allowed_memory(), installation.allowed_processors()) == (2 * 1024**3, 1.5)
    monkeypatch.setattr("equimesh.numerics.threads.available_cores", lambda: 8)
    two = Settings(workers=2, threads=1, memory_limit=4096)
    assert look(installation.processors, two).remedy.endswith("EQUIMESH_WORKERS=1")
    assert look(installation.memory, two).level is WARNING
    assert "this container has 2048 MiB" in look(installation.memory, two).message
    # Two workers that solve, two for files, and the service itself.
    assert look(installation.memory, Settings(workers=2, memory_limit=(2048 - SERVICE_MIB) // 4)).level is OK
    assert look(installation.memory, Settings(workers=2, memory_limit=(2048 - SERVICE_MIB) // 4 + 1)).level is WARNING
    assert look(installation.memory, two).remedy.startswith(
        f"lower EQUIMESH_MEMORY_LIMIT to {(2048 - SERVICE_MIB) // 4},"
    )
    assert look(installation.memory, Settings(workers=13, memory_limit=16)).level is FAILED
    assert look(installation.processors, Settings(workers=1, threads=4)).level is WARNING
    assert look(installation.processors, Settings(workers=1, threads=1)).level is OK


def test_limits_of_an_older_container(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own = "4:memory:/host/path\n3:cpu,cpuacct:/host/path\n"
    limits = {"memory__memory_DOT_limit_in_bytes": "1073741824", "cpu,cpuacct__cpu_DOT_cfs_quota_us": "200000"}
    groups(tmp_path, monkeypatch, own, **limits)
    assert (installation.allowed_memory(), installation.allowed_processors()) == (1024**3, 2.0)
    groups(tmp_path, monkeypatch, own, memory__memory_DOT_limit_in_bytes=str((1 << 63) - 4096))
    assert installation.allowed_memory() is None


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
    assert look(installation.packages, here).message == "sqlalchemy is 1.0; <2.2,>=2.0.30 is needed"
    more = {"database_url": "postgresql://h/n", "files_url": "s3://b", "trace_endpoint": "http://h"}
    found = look(installation.packages, Settings(**more))  # type: ignore[arg-type]
    assert all(f"{name} is not installed" in found.message for name in ("psycopg", "obstore", "opentelemetry-sdk"))
    assert found.remedy == "pip install 'equimesh[service,postgres,s3,tracing]'"


def test_a_misspelled_variable(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EQUIMESH_DATADIR", "x")
    found = look(installation.variables, here)
    assert found.level is WARNING
    assert "did you mean EQUIMESH_DATA_DIR?" in found.message


@pytest.fixture
def loops(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """Sets where loops are kept: how many, in which archive, in which folder."""

    def keep(kept: tuple[int, int, int], *, archive: Any = "none came with it", folder: Any = None) -> None:
        monkeypatch.setattr(compiled, "count_kept", lambda: compiled.Kept(*kept))
        monkeypatch.setattr(machine_code, "find_archive", lambda: archive)
        monkeypatch.setattr(machine_code, "find_folder", lambda: folder or machine_code.Folder(tmp_path))

    return keep


def test_no_folder_for_compiled_loops(here: Settings, loops: Any) -> None:
    loops((100, 0, 53), folder="it belongs to another user")
    found = look(installation.kernels, here)
    assert found.level is WARNING
    assert "EQUIMESH_CACHE_DIR" in found.remedy
    assert "it belongs to another user" in found.message
    assert "about a minute" in found.message
    loops((153, 0, 0), folder="it belongs to another user")
    assert look(installation.kernels, here).level is OK, "all are in the archive"


def test_a_folder_for_compiled_loops_that_cannot_be_written(
    here: Settings, loops: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)
    loops((0, 100, 53))
    found = look(installation.kernels, here)
    assert (found.level, "cannot be written" in found.message) == (WARNING, True)
    loops((0, 153, 0))
    assert look(installation.kernels, here).level is OK


def test_where_the_loops_come_from(here: Settings, loops: Any) -> None:
    loops((0, 100, 53))
    found = look(installation.kernels, here)
    assert found.level is OK
    assert "0 from the archive, 100 from the folder of this user, 53 to be compiled" in found.message
    assert "no archive is used: none came with it; the first start compiles them" in found.message
    loops((150, 3, 0), archive=SimpleNamespace(path="a.loops"))
    found = look(installation.kernels, here)
    assert found.message.endswith("0 to be compiled; the archive a.loops is of other sources, or of fewer loops")


def test_a_solver_that_makes_another_mesh(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    real = equimesh.ArcLength
    monkeypatch.setattr(equimesh, "ArcLength", lambda **given: real(**{**given, "a": 0.6}))
    found = look(installation.solve, here)
    assert found.level is FAILED
    assert "1.1979" in found.message


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """A cluster in threads of this process, of one worker with two threads."""
    with LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp://", dashboard_address="127.0.0.1:0"
    ) as cluster:
        yield cluster


def with_cluster(settings: Settings, address: str) -> Settings:
    """The settings with the engine dask."""
    return settings.model_copy(update={"engine": "dask", "scheduler": address, "memory_limit": 16})


def test_a_service_without_a_cluster_needs_none(here: Settings) -> None:
    assert module.cluster(here) is None


def test_a_cluster_that_can_be_used(made: Settings, cluster: Any) -> None:
    settings = with_cluster(made, cluster.scheduler_address)
    found = look(module.cluster, settings)
    assert (found.level, found.message) == (
        Level.OK,
        f"the cluster at {cluster.scheduler_address}: 1 workers solve 2 meshes at the same time, in the versions of "
        "this service; the first start checks what they reach",
    )
    files = files_address(settings)
    files.open().prepare(alone=True)
    Reach.of(Storage(settings.database, files))
    assert look(module.cluster, settings).message.endswith("all reach the database and the files")
    large = look(module.cluster, settings.model_copy(update={"memory_limit": 1 << 30}))
    assert (large.level, "for 2 meshes of 1073741824 MiB each" in large.message) == (Level.WARNING, True)


def test_workers_that_cannot_be_used(made: Settings, cluster: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = with_cluster(made, cluster.scheduler_address)
    files = files_address(settings)
    files.open().prepare(alone=True)
    reach = replace(Reach.of(Storage(settings.database, files)), folder="of another service")
    monkeypatch.setattr(Reach, "of", lambda *_, **__: reach)
    found = look(module.cluster, settings)
    assert found.level is Level.FAILED
    assert f"it does not see the folder of the service's files, {files.folder}" in found.message
    assert (files.folder / MARK).exists()
    here = examination.versions()
    monkeypatch.setattr(examination, "describe_difference", lambda *_: "equimesh 0.1.0 in place of " + here["equimesh"])
    assert "it has equimesh 0.1.0 in place of" in look(module.cluster, settings).message


def test_a_scheduler_that_cannot_be_reached(made: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examination, "_MAX_CONNECT_SECONDS", 0.5)
    found = look(module.cluster, with_cluster(made, "tcp://127.0.0.1:9"))
    assert found.level is Level.FAILED
    assert found.message == "the scheduler at tcp://127.0.0.1:9 cannot be reached (OSError)"


@pytest.mark.parametrize(
    ("address", "is_open"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
        ("tls://10.0.0.5:8786", False),
        ("tcp://10.0.0.5:8786", True),
        ("tcp://0.0.0.0:8786", True),
        ("ucx://first:8786", True),
    ],
)
def test_a_scheduler_that_others_reach_without_tls_is_open(address: str, is_open: bool) -> None:
    assert module.is_open(address) == is_open


def test_an_open_cluster_is_warned_of(made: Settings) -> None:
    where = {"protocol": "tcp://", "host": "0.0.0.0", "dashboard_address": "127.0.0.1:0"}
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, **where) as opened:
        port = opened.scheduler.port
        found = look(module.cluster, with_cluster(made, f"tcp://127.0.0.1:{port}"))
    assert found.level is Level.WARNING
    assert "can run programs on all of them" in found.message
    assert "dask scheduler --host 127.0.0.1" in found.remedy
