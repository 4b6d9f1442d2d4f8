"""Two clusters for all tests of the folder: threads of this process, and processes that may be killed."""

from __future__ import annotations

from collections.abc import Iterator

import dask
import pytest
from distributed import Client, LocalCluster

from dask_processes import DaskProcesses

SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.locks.lease-timeout": "3s",
    "distributed.scheduler.locks.lease-validation-interval": "100ms",
}


@pytest.fixture(scope="session")
def client() -> Iterator[Client]:
    """A client of three workers with two threads each, in this process."""
    options = {"dashboard_address": ":0", "processes": False, "threads_per_worker": 2, "memory_limit": 0}
    with (
        dask.config.set(SETTINGS),
        LocalCluster(n_workers=3, **options) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        yield client


@pytest.fixture(scope="session")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskProcesses]:
    """A scheduler and two workers as processes; a test that kills one starts another one by ``have``."""
    with dask.config.set(SETTINGS):
        processes = DaskProcesses(tmp_path_factory.mktemp("dask"))
        try:
            yield processes
        finally:
            processes.close()
