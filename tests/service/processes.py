"""A service as a process of its own, which tests kill, and the processes below it."""

from __future__ import annotations

import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import httpx

_START_SECONDS = 300.0
_STOP_SECONDS = 120.0
_CUT_OFF = re.compile(
    r"Traceback \(most recent call last\):\n  File \"<string>\", line 1, in <module>\n"
    r"  File \"[^\"\n]*forkserver\.py\", line \d+, in main\n(?: {4}.*\n|  File .*\n)+EOFError\n"
)
"""What a fork server prints where its service is killed while it requests a process from it."""


@dataclass
class ServiceProcess:
    """``equimesh serve`` on a port and a folder; it can be killed and started again any number of times.

    Every process runs the code ``first`` when it starts.
    """

    folder: Path
    port: int
    settings: dict[str, str]
    workers: int = 2
    first: str = ""
    _process: subprocess.Popen[bytes] | None = field(default=None, init=False)
    _below: set[int] = field(default_factory=set, init=False)

    @property
    def url(self) -> str:
        """Its address, also while it is down."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def pid(self) -> int:
        """The process of the service itself."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it has been started, and has not ended."""
        return self._process is not None and self._process.poll() is None

    @property
    def log(self) -> str:
        """The output of all its processes so far."""
        return (self.folder / "log").read_text()

    @property
    def has_traceback(self) -> bool:
        """Whether a process printed one, besides a fork server that lost a service that was killed."""
        return "Traceback" in _CUT_OFF.sub("", self.log)

    def start(self) -> None:
        """Start, without waiting until it is ready."""
        command = [sys.executable, "-m", "equimesh_cli", "serve", "--port", str(self.port)]
        command += ["--data-dir", str(self.folder / "data"), "--workers", str(self.workers)]
        settings = {"LOG_LEVEL": "warning", "THREADS": "1", **self.settings}
        environment = {**os.environ, **{f"EQUIMESH_{name}": value for name, value in settings.items()}}
        self.folder.mkdir(exist_ok=True)
        if self.first:
            # Python runs this module at the start of every process.
            (self.folder / "sitecustomize.py").write_text(self.first)
            environment["PYTHONPATH"] = os.pathsep.join((str(self.folder), *filter(None, [os.getenv("PYTHONPATH")])))
        with (self.folder / "log").open("a") as log:
            self._process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)

    def ready(self) -> None:
        """Wait until the workers are ready, too."""
        until = time.monotonic() + _START_SECONDS
        while not is_ready(self.url):
            assert self._process.poll() is None, self.log
            assert time.monotonic() < until, self.log
            time.sleep(0.05)

    def worker_pids(self) -> list[int]:
        """The worker processes: those that solve, and those that write files."""
        found = [pid for child in children(self.pid, deep=False) for pid in children(child, deep=False)]
        self._below.update(found)
        return found

    def kill(self) -> None:
        """Kill the service, as a crash does."""
        self._end(signal.SIGKILL)

    def stop(self) -> int:
        """Stop it by SIGTERM; returns its exit code."""
        return self._end(signal.SIGTERM)

    def signal(self, number: int) -> None:
        """Send the service a signal, without waiting."""
        os.kill(self.pid, number)

    @contextmanager
    def frozen(self, pids: Iterable[int] = ()) -> Iterator[None]:
        """Stop these of its processes, or all, for the length of a ``with``, as on a suspended machine."""
        pids = [*pids] or [self.pid, *children(self.pid)]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGCONT)

    def wait(self, seconds: float = _STOP_SECONDS) -> int:
        """The exit code, once it has ended."""
        return self._process.wait(seconds)

    def left(self) -> list[int]:
        """Processes of this service, or of earlier ones in this folder, that still run after its end."""
        return [pid for pid in self._below if runs(pid)]

    def _end(self, number: int) -> int:
        self._below.update(children(self.pid))
        self.signal(number)
        return self.wait()

    def close(self) -> None:
        """End it in whatever state it is."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()


@contextmanager
def service_process(folder: Path, *, workers: int = 2, first: str = "", **settings: str) -> Iterator[ServiceProcess]:
    """A service that is not started yet, and is ended after the ``with``; settings as in the environment."""
    service = ServiceProcess(folder, free_port(), settings, workers, first)
    try:
        yield service
    finally:
        service.close()


def free_port() -> int:
    """A free port, outside of the range that the system gives to connections."""
    while True:
        port = random.randrange(20_000, 32_000)
        with socket.socket() as listener:
            try:
                listener.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port


def children(pid: int, *, deep: bool = True) -> list[int]:
    """All processes below ``pid``, or only those that it started itself."""
    below: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError, IndexError):
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                below.setdefault(parent, []).append(int(entry.name))
    found, todo = list[int](), below.get(pid, [])
    while todo:
        found += todo
        todo = [child for one in todo for child in below.get(one, [])] if deep else []
    return found


def runs(pid: int) -> bool:
    """Whether a process exists and has not ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def command_of(pid: int) -> str:
    """The command line of a process, "" when it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
    except OSError:
        return ""


def is_ready(url: str) -> bool:
    """Whether a service reports that it is ready."""
    try:
        return httpx.get(f"{url}/readyz", timeout=10.0).status_code == 200
    except httpx.TransportError:
        return False
