"""A cluster of Dask as processes: a scheduler and workers that tests may kill."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from distributed import Client

START_SECONDS = 300.0
"""How long a process may take to start, on a machine that has much else to do."""
SETTINGS = {
    "DASK_DISTRIBUTED__SCHEDULER__LOCKS__LEASE_VALIDATION_INTERVAL": "200ms",
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "30s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__GIL__ENABLED": "False",
}


class DaskProcesses:
    """A scheduler on a free port, and workers by their names. Their output goes to files in ``folder``."""

    def __init__(self, folder: Path, settings: dict[str, str] | None = None) -> None:
        self.folder = folder
        self.workers: dict[str, subprocess.Popen[bytes]] = {}
        path = os.pathsep.join([str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        self._settings = {**os.environ, **SETTINGS, "PYTHONPATH": path, **(settings or {})}
        self._file = folder / "scheduler.json"
        options = ("--port", "0", "--no-dashboard", "--no-show", "--scheduler-file", str(self._file))
        self.scheduler = self._start("scheduler", "scheduler", *options)
        self._wait(self._file.exists, "the scheduler")
        self.client = Client(scheduler_file=str(self._file), timeout=START_SECONDS, set_as_default=False)
        self.address = self.client.scheduler.address
        self._made = 0

    def add(self, count: int = 1, threads: int = 1) -> list[str]:
        """Start workers, and wait until they are there. Returns their names."""
        names = [f"worker-{self._made + k}" for k in range(count)]
        self._made += count
        for name in names:
            options = ("--name", name, "--nthreads", str(threads), "--no-nanny", "--no-dashboard")
            place = ("--local-directory", str(self.folder / name))
            self.workers[name] = self._start(name, "worker", self.address, *options, *place)
        self._wait(lambda: {*names} <= {*self.addresses()}, "workers")
        return names

    def addresses(self) -> dict[str, str]:
        """The addresses of the workers that the scheduler knows, by their names."""
        known = self.client.scheduler_info(n_workers=-1)["workers"]
        return {str(worker["name"]): address for address, worker in known.items()}

    def name_at(self, address: str) -> str:
        """The name of the worker at an address."""
        return next(name for name, found in self.addresses().items() if found == address)

    def kill(self, name: str) -> None:
        """Kill a worker at once."""
        process = self.workers.pop(name)
        process.kill()
        process.wait()

    def have(self, count: int) -> None:
        """Start as many workers as are missing to ``count``, also for those that ended by themselves."""
        for name in [name for name, process in self.workers.items() if process.poll() is not None]:
            del self.workers[name]
        self._wait(lambda: len(self.client.nthreads()) <= len(self.workers), "the end of killed workers")
        if len(self.workers) < count:
            self.add(count - len(self.workers))

    def close(self) -> None:
        """End all processes."""
        self.client.close()
        for process in (*self.workers.values(), self.scheduler):
            process.kill()
            process.wait()

    def _start(self, name: str, command: str, *options: str) -> subprocess.Popen[bytes]:
        with (self.folder / f"{name}.log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", command, *options], env=self._settings, stdout=log, stderr=log
            )

    def _wait(self, done: object, what: str) -> None:
        """Wait until ``done()``."""
        latest = time.monotonic() + START_SECONDS
        while not done():  # type: ignore[operator]
            if time.monotonic() > latest:
                raise TimeoutError(f"{what}: {sorted(self.folder.iterdir())}")
            time.sleep(0.05)
