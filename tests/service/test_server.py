"""The server on its port: answers are sent at once, also to many simultaneous requests."""

from __future__ import annotations

import io
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from equimesh.compiling import Line
from equimesh_service import Settings, server
from equimesh_service.errors import NotStartedError
from service.conftest import small
from service.requests import WAIT


def test_small_answers_are_sent_at_once(http: httpx.Client, finished: dict[str, Any]) -> None:
    def seconds() -> float:
        began = time.perf_counter()
        http.get(finished["links"]["self"])
        return time.perf_counter() - began

    assert any(seconds() < 0.03 for _ in range(300)), "Nagle's algorithm holds every answer back for 40 ms"


SCRIPT = """
import sys
from pathlib import Path
import httpx
from equimesh_service import Settings, running
with running(Settings(data_dir=Path(sys.argv[1]), port=0, workers=1, log_level="error")) as url:
    print(httpx.get(f"{url}/livez").json()["status"])
    spec = {"monitor": {"kind": "arc_length", "u": "x"}, "grid": {"n_xi": 5, "n_eta": 5}}
    for query, wait in (("", 60), ("?store=false", 60), ("?reuse=false", 0)):
        answer = httpx.post(f"{url}/v1/meshes{query}", json=spec, headers={"Prefer": f"wait={wait}"}, timeout=120.0)
        print(answer.status_code, "numba" in sys.modules or "scipy" in sys.modules)
"""


def test_a_script_without_a_main_guard_starts_one_service_which_loads_the_solver_when_it_checks_a_request(
    tmp_path: Path,
) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "data")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout, done.stderr[-1000:]) == (0, "ok\n201 False\n200 False\n202 True\n", "")


def test_the_same_expression_under_load(url: str) -> None:
    answers: list[httpx.Response] = []

    def ask() -> None:
        with httpx.Client(base_url=url, timeout=600.0) as client:
            answers.append(client.post("/v1/meshes?format=npz", json=small(), headers=WAIT))

    threads = [threading.Thread(target=ask) for _ in range(12)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} == {201}
    assert len({answer.headers["etag"] for answer in answers}) == 1


class Starting:
    """A server whose workers compile one loop more at each look; an hour passes between two looks."""

    def __init__(self, *, loops: int, fault: str = "") -> None:
        self.compiled, self.loops, self.fault = 0, loops, fault
        self.readiness = SimpleNamespace(warm_up=self._warm_up)
        self.state = SimpleNamespace(service=self)
        self.config, self.started = SimpleNamespace(app=self), True

    @property
    def is_ready(self) -> bool:
        return self.compiled == self.loops

    def _warm_up(self) -> dict[str, int]:
        self.compiled += 1
        return {"compiled": self.compiled, "of": self.loops}

    def clock(self) -> float:
        return 3600.0 * self.compiled


class Shown(Line):
    """A line that remembers what it showed."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: list[tuple[int, int]] = []

    def show(self, compiled: int, of: int, *, are_all_needed: bool = True) -> None:
        assert are_all_needed
        self.counts.append((compiled, of))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_LOOK_SECONDS", "_LINE_SECONDS", "_LOG_SECONDS"):
        monkeypatch.setattr(server, name, -1.0)


@pytest.mark.usefixtures("quick")
def test_a_service_that_compiles_is_waited_for_however_long_it_takes(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    there, line = Starting(loops=20), Shown()
    monkeypatch.setattr(server, "time", SimpleNamespace(monotonic=there.clock))
    with caplog.at_level(logging.INFO):
        server._Start(there, line=line).wait()  # type: ignore[arg-type]
    assert line.counts == [(number, 20) for number in range(1, 21)]
    assert "compiling the numerical loops: 7 of 20" in caplog.messages
    assert caplog.messages[-1] == "ready after 72000.0 s"


@pytest.mark.usefixtures("quick")
def test_a_service_that_cannot_start_says_why() -> None:
    there = Starting(loops=20, fault="the workers cannot warm up: OSError: no space")
    with pytest.raises(NotStartedError, match=r"did not start: the workers cannot warm up: OSError: no space"):
        server._Start(there).wait()  # type: ignore[arg-type]
    there = Starting(loops=20)
    there.state = SimpleNamespace(fault="OSError: the disk is gone")  # type: ignore[assignment]
    start = server._Start(there)  # type: ignore[arg-type]
    start.is_over.set()
    with pytest.raises(NotStartedError, match=r"did not start: OSError: the disk is gone"):
        start.wait()


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("at_terminal", [True, False])
def test_at_a_terminal_the_address_stands_alone(
    at_terminal: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    used: list[Settings] = []

    class Ready(Starting):
        def run(self, sockets: list[socket.socket]) -> None:
            logging.getLogger("uvicorn.error").info("Application startup complete.")
            for one in sockets:
                one.close()
            for thread in threading.enumerate():
                if thread.name == "equimesh-start":
                    thread.join(60.0)

    def make(settings: Settings) -> Ready:
        used.append(settings)
        return Ready(loops=0)

    for name in [name for name in os.environ if name.startswith("EQUIMESH_")]:
        monkeypatch.delenv(name)  # a line would tell of each that is no setting
    monkeypatch.setattr(logging.getLogger("uvicorn.error"), "level", logging.NOTSET)  # uvicorn sets it, for good
    root = logging.getLogger()
    monkeypatch.setattr(root, "handlers", [])
    monkeypatch.setattr(root, "level", root.level)
    monkeypatch.setattr(sys, "stderr", stream := io.StringIO())
    monkeypatch.setattr(server, "is_live", lambda: at_terminal)
    monkeypatch.setattr(server, "_server", make)
    monkeypatch.setattr(server, "_open", lambda settings: server._listen(settings))
    server.run(Settings(port=0, data_dir=tmp_path))
    lines = stream.getvalue().splitlines()
    if at_terminal:
        assert used[0].log_level == "warning"
        assert len(lines) == 1
        assert lines[0].startswith("equimesh is at http://127.0.0.1:")
    else:
        assert used[0].log_level == "info"
        assert any("listening on http://127.0.0.1:" in line for line in lines)
        assert any("ready after" in line for line in lines)
