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

from service.processes import children, free_port

TESTS = Path(__file__).parents[1]


@dataclass
class ClusterProcesses:
    """A scheduler at an address that it keeps, and workers by their names; their logs are in ``folder``."""

    folder: Path
    port: int = field(default_factory=free_port)
    environment: dict[str, str] = field(default_factory=dict)
    workers: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    _scheduler: subprocess.Popen[bytes] | None = None

    @property
    def scheduler(self) -> str:
        """The address of the scheduler, also while it is down."""
        return f"tcp://127.0.0.1:{self.port}"

    def start_scheduler(self) -> None:
        """Start the scheduler, without waiting for it."""
        words = ["dask", "scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard"]
        self._scheduler = self._start("scheduler", [*words, "--dashboard-address", "127.0.0.1:0"])

    def kill_scheduler(self) -> None:
        """Kill the scheduler, as a crash does."""
        assert self._scheduler is not None
        _kill(self._scheduler)

    def start_worker(self, name: str, *options: str, slots: int = 1, **environment: str) -> None:
        """Start a worker of Dask, without waiting for it."""
        words = ["dask", "worker", self.scheduler, "--name", name, "--nthreads", str(slots), "--no-dashboard"]
        words += ["--local-directory", str(self.folder / name), *options]
        self.workers[name] = self._start(name, words, environment)

    def kill_worker(self, name: str) -> None:
        """Kill a worker and all processes below it, as the end of a machine does."""
        _kill(self.workers.pop(name))

    def log(self, name: str) -> str:
        """The output of a worker, or of the scheduler."""
        return (self.folder / f"{name}.log").read_text()

    def close(self) -> None:
        """End all of it."""
        for name in [*self.workers]:
            self.kill_worker(name)
        if self._scheduler is not None:
            _kill(self._scheduler)

    def _start(self, name: str, words: list[str], environment: dict[str, str] | None = None) -> subprocess.Popen[bytes]:
        self.folder.mkdir(exist_ok=True)
        path = os.pathsep.join([str(TESTS), *filter(None, [os.getenv("PYTHONPATH")])])
        variables = {**os.environ, "PYTHONPATH": path, **self.environment, **(environment or {})}
        with (self.folder / f"{name}.log").open("a") as log:
            return subprocess.Popen([sys.executable, "-m", *words], env=variables, stdout=log, stderr=log)


def _kill(process: subprocess.Popen[bytes]) -> None:
    below = children(process.pid)
    for pid in (process.pid, *below):  # from the top, so that none is started again
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
