"""A cluster of Dask as processes, which tests kill: a scheduler, and workers."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from service.processes import children, free_port

TESTS = Path(__file__).parents[1]
COMPOSE = TESTS.parent / "compose.yaml"


@dataclass
class ClusterProcesses:
    """A scheduler at an address that it keeps, and workers by their names; their logs are in ``folder``."""

    folder: Path
    port: int = field(default_factory=free_port)
    environment: dict[str, str] = field(default_factory=dict)
    health_port: int = field(default_factory=free_port)  # of the scheduler
    health_ports: dict[str, int] = field(default_factory=dict)  # of workers
    workers: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    _scheduler: subprocess.Popen[bytes] | None = None

    @property
    def scheduler(self) -> str:
        """The address of the scheduler, also while it is down."""
        return f"tcp://127.0.0.1:{self.port}"

    def start_scheduler(self) -> None:
        """Start the scheduler by the command of the compose file, without waiting for it."""
        ports = {"8786": str(self.port), ":8787": f"127.0.0.1:{self.health_port}"}
        words = [ports.get(word, word) for word in _service("scheduler")["command"]]
        self._scheduler = self._start("scheduler", [*words, "--host", "127.0.0.1"])

    def kill_scheduler(self) -> None:
        """Kill the scheduler, as a crash does."""
        assert self._scheduler is not None
        _kill(self._scheduler)

    def start_worker(self, name: str, *options: str, slots: int = 1, **environment: str) -> None:
        """Start a worker of Dask, without waiting for it."""
        words = ["dask", "worker", self.scheduler, "--name", name, "--nthreads", str(slots), "--no-dashboard"]
        words += ["--local-directory", str(self.folder / name), *options]
        self.workers[name] = self._start(name, words, environment)

    def start_own_worker(self, name: str, *, slots: int = 2) -> None:
        """Start a worker by the command of the compose file, without waiting for it."""
        port = self.health_ports.setdefault(name, free_port())
        words = [{"8787": str(port)}.get(word, word) for word in _service("worker")["command"]]
        variables = {"EQUIMESH_SCHEDULER": self.scheduler, "EQUIMESH_WORKERS": str(slots)}
        self.workers[name] = self._start(name, [*words, "--name", name], variables)

    def is_healthy(self, service: str, name: str = "") -> bool:
        """Whether the health check of a service of the compose file succeeds, for a worker with its ``name``."""
        port = self.health_ports[name] if name else self.health_port
        _, *words = _service(service)["healthcheck"]["test"]
        words = [word.replace(":8787", f":{port}") for word in words]
        return subprocess.run([sys.executable, *words[1:]], capture_output=True, timeout=300).returncode == 0

    def kill_worker(self, name: str, *, below: bool = True) -> None:
        """Kill a worker, with all processes ``below`` it as the end of a machine does, or alone."""
        _kill(self.workers.pop(name), below=below)

    def log(self, name: str) -> str:
        """The output of a worker, or of the scheduler."""
        return (self.folder / f"{name}.log").read_text()

    def close(self) -> None:
        """End all of it."""
        for name in [*self.workers]:
            self.kill_worker(name)
        if self._scheduler is not None:
            _kill(self._scheduler)
            self._scheduler = None

    def _start(self, name: str, words: list[str], environment: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        self.folder.mkdir(exist_ok=True)
        path = os.pathsep.join([str(TESTS), *filter(None, [os.getenv("PYTHONPATH")])])
        variables = {**os.environ, "PYTHONPATH": path, **self.environment, **(environment or {})}
        with (self.folder / f"{name}.log").open("a") as log:
            module = {"equimesh": "equimesh_cli"}.get(words[0], words[0])
            command = [sys.executable, "-m", module, *words[1:]]
            return subprocess.Popen(command, env=variables, stdout=log, stderr=log)


def _service(name: str) -> dict[str, Any]:
    """A service of the compose file."""
    found: dict[str, Any] = yaml.safe_load(COMPOSE.read_text())["services"][name]
    return found


def _kill(process: subprocess.Popen[bytes], *, below: bool = True) -> None:
    found = children(process.pid) if below else []
    for pid in (process.pid, *found):  # from the top, so that none is started again
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


@contextmanager
def cluster_processes(folder: Path, **environment: str) -> Iterator[ClusterProcesses]:
    """A cluster of which nothing is started yet, and all is ended after the ``with``."""
    cluster = ClusterProcesses(folder, environment=environment)
    try:
        yield cluster
    finally:
        cluster.close()
