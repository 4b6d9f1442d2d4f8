"""Commands are run against the services that other tests use."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from client.conftest import connect, fault, service
from equimesh_cli import main
from equimesh_cli.checks.installation import Finding
from equimesh_cli.commands import doctor
from equimesh_service import Settings
from equimesh_service.store.database import upgrade
from service.conftest import database_url, document, finished, guarded_service, http, observed, postgres, settings, url
from service.databases import ADDRESS, NEEDED

__all__ = [
    "connect", "database_url", "document", "fault", "finished", "guarded_service", "http", "observed", "postgres",
    "service", "settings", "url",
]  # fmt: skip


@pytest.fixture
def generate(service: Any, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs `equimesh generate` against the fake service; gives code, output and errors."""

    def run(*arguments: str) -> tuple[int, str, str]:
        code = main(["generate", *arguments, "--url", service.url])
        said = capsys.readouterr()
        return code, said.out, said.err

    return run


@pytest.fixture
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """No settings in the environment but those of the test databases."""
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
    """What a check finds, as `equimesh doctor` reports it."""
    found = doctor._try_check(check, subject)
    assert found is not None
    return found
