"""Checks of processors and memory."""

from __future__ import annotations

from pathlib import Path

import pytest

from cli.conftest import look
from equimesh_cli.checks import installation
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings
from equimesh_service.settings import SERVICE_MIB

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
