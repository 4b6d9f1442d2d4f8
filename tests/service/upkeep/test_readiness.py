"""/readyz names the parts that do not work, without their addresses; frequent probes cost nothing."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from equimesh_service import Settings
from equimesh_service.api.app import create_app
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.files.folder import FolderFiles
from equimesh_service.service import PRELOAD, _health
from equimesh_service.store.store import Store
from equimesh_service.upkeep.readiness import OK, Readiness
from service.conftest import until
from service.engine.check_engine import own_pid


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def test_a_service_that_works_is_ready(http: httpx.Client) -> None:
    answer = http.get("/readyz")
    assert (answer.status_code, answer.json()["status"], answer.json()["warnings"]) == (200, "ok", [])
    assert set(answer.json()["checks"]) == {"store", "files", "engine", "exports", "dispatcher"}
    for path in ("/readyz", "/livez"):
        head = http.head(path)
        assert (head.status_code, head.content) == (200, b"")


@pytest.mark.anyio
async def test_what_does_not_work_is_named_without_its_address(tmp_path: Path) -> None:
    store, files = Store(f"sqlite:///{tmp_path / 'no' / 'such.sqlite3'}"), FolderFiles(tmp_path / "gone")
    app = create_app(Settings(data_dir=tmp_path))
    checks: dict[str, Any] = {"store": store.check, "files": files.check, "engine": lambda: "workers are starting"}
    app.state.service = SimpleNamespace(readiness=Readiness(checks, warn=[lambda: "the clock is wrong", lambda: None]))
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as http:
        answer = await http.get("/readyz")
        assert (await http.head("/readyz")).status_code == answer.status_code == 503
    store.close()
    assert answer.json() == {
        "status": "unavailable",
        "checks": {
            "store": "The database cannot be used now.",
            "files": answer.json()["checks"]["files"],
            "engine": "workers are starting",
        },
        "warnings": ["the clock is wrong"],
    }
    assert answer.json()["checks"]["files"] != OK
    assert str(tmp_path) not in answer.text
    assert "such.sqlite3" not in answer.text


@pytest.mark.anyio
@pytest.mark.parametrize("warm_up", [{"compiled": 37, "of": 153}, {"compiled": 0, "of": 0}, None])
async def test_a_service_that_warms_up_says_how_far_it_is(tmp_path: Path, warm_up: dict[str, int] | None) -> None:
    app = create_app(Settings(data_dir=tmp_path))
    readiness = Readiness({"engine": lambda: "workers are starting"}, warm_up=lambda: warm_up)
    app.state.service = SimpleNamespace(readiness=readiness)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as http:
        answer = await http.get("/readyz")
    assert answer.status_code == 503
    assert answer.json().get("warm_up") == warm_up


@pytest.mark.anyio
async def test_probes_share_a_look() -> None:
    looks: list[int] = []

    def slow() -> None:
        time.sleep(0.1)
        looks.append(1)

    readiness = Readiness({"slow": slow})
    said = await asyncio.gather(*(readiness.check() for _ in range(20)))
    assert said == [{"slow": OK}] * 20
    assert len(looks) == 1
    await asyncio.sleep(1.0)
    await readiness.check()
    assert len(looks) == 2


@pytest.mark.anyio
async def test_a_room_that_hangs_is_not_ready() -> None:
    free = threading.Event()
    files = threading.Event()
    readiness = Readiness({"store": lambda: free.wait(600) and None, "files": files.set}, timeout=3.0)
    assert await readiness.check() == {"store": "no answer within 3 s", "files": OK}
    free.set()


def test_an_engine_whose_workers_were_killed_says_so_and_recovers() -> None:
    engine = ProcessEngine(1, preload=PRELOAD)
    try:
        assert engine.wait_until_ready(60.0)
        assert _health(engine) == OK
        os.kill(engine.submit(own_pid).result(20.0), signal.SIGKILL)
        assert until(lambda: _health(engine) != OK and _health(engine)) in (
            "the worker pool is down",
            "workers are starting",
        )
        assert engine.wait_until_ready(60.0)
    finally:
        engine.close()
