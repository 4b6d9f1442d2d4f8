"""Checks of what is installed."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import equimesh
from cli.conftest import look
from equimesh.numerics import compiled, machine_code
from equimesh_cli.checks import installation
from equimesh_cli.checks.installation import Level
from equimesh_service import Settings

OK = Level.OK
WARNING = Level.WARNING
FAILED = Level.FAILED
pytestmark = pytest.mark.usefixtures("no_variables")


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
