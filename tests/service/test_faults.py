"""What breaks is mended: killed workers, killed services, limits of time and memory."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

import httpx
import pytest

from equimesh_service import Settings, running
from equimesh_service.dispatcher import Dispatcher, Rules
from equimesh_service.engine import Health
from equimesh_service.pebble_engine import PebbleEngine
from equimesh_service.rows import Claim, NewMesh
from equimesh_service.service import PRELOAD, FolderInUseError, open_service
from equimesh_service.store import Store
from service.check_engine import add, allocate
from service.conftest import SLOW, small, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills and limits are Linux's")
SPEC: dict[str, Any] = {"label": None, "grid": {"n_xi": 8, "n_eta": 8}, "cells": "quad"}
PROGRAM = """
    import sys
    from pathlib import Path
    from equimesh_service import Settings, run

    if __name__ == "__main__":
        run(Settings(data_dir=Path(sys.argv[1]), port=int(sys.argv[2]), workers=1, lease=60.0))
"""


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def children(pid: int) -> list[int]:
    """All processes below ``pid``."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except (OSError, IndexError):
                continue
            if parent == pid:
                found += [int(entry.name), *children(int(entry.name))]
    return found


def die(marker: str) -> None:
    """A task that kills its worker, and counts how often it began."""
    with Path(marker).open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(marker: str, url: str, claim: Claim) -> None:
    """A task that kills its worker the first time, and succeeds the second."""
    if not Path(marker).exists():
        die(marker)
    store = Store(url)
    store.queue.finish(claim)
    store.close()


def test_a_killed_worker_does_not_lose_its_mesh(tmp_path: Path, database_url: str) -> None:
    store, engine = Store(database_url), PebbleEngine(1, preload=PRELOAD)
    store.prepare()
    marker = str(tmp_path / "marker")
    dispatcher = Dispatcher(
        "me", store, engine, lambda claim, _: (die_once, (marker, database_url, claim)), Rules(), lambda _: None
    )
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert (row.status, row.attempt) == ("succeeded", 2)
        story = [(event.kind, event.data.get("status"), event.data.get("reason")) for event in store.meshes.events("a")]
        assert story[2] == ("status", "queued", "the worker process died")
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


def test_a_mesh_that_kills_its_workers_fails_after_three(tmp_path: Path) -> None:
    store, engine = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}"), PebbleEngine(1, preload=PRELOAD)
    store.prepare()
    marker = tmp_path / "marker"
    dispatcher = Dispatcher("me", store, engine, lambda *_: (die, (str(marker),)), Rules(), lambda _: None)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert row.status == "failed"
        assert row.error["type"] == "/problems/worker-lost"
        assert "3 attempts" in row.error["detail"]
        assert marker.read_text() == "xxx"
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


class Sluggish:
    """An engine in which a mesh is canceled at the very moment that its task is submitted."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.canceled: list[Future[Any]] = []

    def submit(self, function: Any, *arguments: Any, time_limit: float | None = None) -> Future[Any]:
        assert (function, arguments, time_limit) == (add, (1, 1), 300.0)
        assert self.store.queue.cancel("a")
        return Future()

    def cancel(self, task: Future[Any]) -> None:
        self.canceled.append(task)
        if not task.done():
            task.set_exception(CancelledError())

    def health(self) -> Health:
        return Health(ready=True, workers=1)

    def close(self) -> None:
        raise AssertionError


def test_a_cancel_between_claim_and_submission_is_seen(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    engine = Sluggish(store)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher = Dispatcher("me", store, engine, lambda *_: (add, (1, 1)), Rules(), lambda _: None)
    dispatcher.start(alone=True)
    try:
        until(lambda: engine.canceled, 2.0)
    finally:
        dispatcher.stop()
        store.close()


def test_a_worker_killed_during_a_real_solve(http: httpx.Client) -> None:
    spec = {**SLOW, "grid": {"n_xi": 24, "n_eta": 24}, "schwarz": {**SLOW["schwarz"], "max_iterations": 20}}
    mesh = http.post("/v1/meshes", json=spec).json()
    until(lambda: http.get(mesh["links"]["self"]).json()["progress"]["fraction"] > 0)
    busiest = max(children(os.getpid()), key=_cpu_seconds)
    os.kill(busiest, signal.SIGKILL)
    final = until(lambda: (m := http.get(mesh["links"]["self"] + "?wait=5").json())["finished_at"] and m, 60.0)
    assert final["status"] == "succeeded", final["error"]
    assert final["attempts"] == 2


def _cpu_seconds(pid: int) -> float:
    """Processor time of a process since this function saw it first a tenth of a second ago."""

    def used() -> int:
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return 0
        return int(fields[11]) + int(fields[12])

    before = used()
    time.sleep(0.1)
    return used() - before


def test_a_killed_service_goes_on_where_it_was(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(textwrap.dedent(PROGRAM))
    data, port = tmp_path / "data", free_port()
    command = [sys.executable, str(program), str(data), str(port)]

    def start() -> subprocess.Popen[bytes]:
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        until(lambda: _ready(port), 120.0)
        return process

    process = start()
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=60.0) as http:
            spec = {**SLOW, "grid": {"n_xi": 24, "n_eta": 24}, "schwarz": {**SLOW["schwarz"], "max_iterations": 20}}
            meshes = [http.post("/v1/meshes", json=spec).json(), http.post("/v1/meshes", json=small()).json()]
            until(lambda: http.get(meshes[0]["links"]["self"]).json()["progress"]["fraction"] > 0)
            workers = children(process.pid)
            process.kill()
            process.wait()
            until(lambda: not any(_runs(pid) for pid in workers), 10.0)  # nobody computes for a dead service
            process = start()
            final = [http.get(mesh["links"]["self"] + "?wait=30").json() for mesh in meshes]
            assert [mesh["status"] for mesh in final] == ["succeeded", "succeeded"]
            assert [mesh["attempts"] for mesh in final] == [2, 1]
            assert http.get(final[0]["links"]["file"]).status_code == 200
            process.send_signal(signal.SIGTERM)
            assert process.wait(20.0) in (0, -signal.SIGTERM)
            assert not any(_runs(pid) for pid in children(process.pid))
    finally:
        process.kill()
        process.wait()


def _ready(port: int) -> bool:
    try:
        return httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200
    except httpx.TransportError:
        return False


def _runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("function", "arguments", "name"),
    [(allocate, (1000,), "memory-limit"), (time.sleep, (30,), "time-limit"), (add, (1, 1), "internal-error")],
)
def test_a_job_that_breaks_a_limit_fails_and_says_so(
    tmp_path: Path, function: Any, arguments: tuple[Any, ...], name: str
) -> None:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    engine = PebbleEngine(1, memory_limit=64, preload=PRELOAD)
    store.prepare()
    rules = Rules(time_limit=0.4, memory_limit=64)
    dispatcher = Dispatcher("me", store, engine, lambda *_: (function, arguments), rules, lambda _: None)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert (row.status, row.error["type"], row.attempt) == ("failed", f"/problems/{name}", 1)
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


def test_limits_and_a_stop_of_the_service(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, port=0, workers=1, time_limit=1.5, max_queue=2, log_level="error")
    with running(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
        slow = http.post("/v1/meshes", json=SLOW, headers={"Prefer": "wait=30"}).json()
        assert (slow["status"], slow["error"]["type"]) == ("failed", "/problems/time-limit")
        assert "1.5 s" in slow["error"]["detail"]
        answer = http.get(slow["links"]["file"])
        assert (answer.status_code, answer.json()["type"]) == (409, "/problems/time-limit")
        with pytest.raises(FolderInUseError), running(settings):
            pass
        last = http.post("/v1/meshes", json=SLOW).json()
        until(lambda: http.get(last["links"]["self"]).json()["status"] == "running")
        for _ in range(2):
            assert http.post("/v1/meshes", json=small()).status_code == 202
        full = http.post("/v1/meshes", json=small())
        assert (full.status_code, full.json().get("type")) == (429, "/problems/queue-full")
    store = Store(settings.database)
    row = store.meshes.get(last["id"])
    store.close()
    assert row is not None
    assert (row.status, row.attempt) == ("queued", 1)


def test_a_stop_does_not_wait_for_those_who_wait(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, port=0, workers=1, log_level="error")
    answers: list[int] = []
    with running(settings) as url:
        mesh = httpx.post(f"{url}/v1/meshes", json=SLOW).json()

        def follow(path: str) -> None:
            answers.append(httpx.get(f"{url}{mesh['links']['self']}{path}", timeout=60.0).status_code)

        threads = [threading.Thread(target=follow, args=(path,)) for path in ("?wait=30", "/events")]
        for thread in threads:
            thread.start()
        time.sleep(0.5)
        began = time.monotonic()
    for thread in threads:
        thread.join()
    assert answers == [200, 200]
    assert time.monotonic() - began < 4.0


@pytest.mark.anyio
async def test_a_folder_serves_one_service(settings: Settings, url: str) -> None:
    assert url
    with pytest.raises(FolderInUseError):
        open_service(settings)


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"
