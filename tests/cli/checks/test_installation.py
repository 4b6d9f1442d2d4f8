"""Checks of what is installed."""

from __future__ import annotations

import importlib.metadata
import platform

import pytest

import equimesh
from cli.conftest import look
from equimesh.numerics import compiled
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


def test_no_folder_for_compiled_loops(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled, "cache_folder", lambda: None)
    found = look(installation.kernels, here)
    assert found.level is WARNING
    assert "NUMBA_CACHE_DIR" in found.remedy
    assert "about a minute" in found.message


@pytest.mark.parametrize("count", [37, 153])
def test_how_many_loops_are_compiled(here: Settings, monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    monkeypatch.setattr(compiled, "count_compiled", lambda: compiled.Compiled(count, 153))
    found = look(installation.kernels, here)
    assert found.level is OK
    assert found.message.startswith(f"{count} of 153 numerical loops are compiled")
    assert ("the first start compiles the others" in found.message) == (count < 153)


def test_a_solver_that_makes_another_mesh(here: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    real = equimesh.ArcLength
    monkeypatch.setattr(equimesh, "ArcLength", lambda **given: real(**{**given, "a": 0.6}))
    found = look(installation.solve, here)
    assert found.level is FAILED
    assert "1.1979" in found.message
