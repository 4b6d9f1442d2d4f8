"""Jobs arrive while workers, their processes, the scheduler and the service are killed, and nothing is lost."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from equimesh_service.store.store import Store
from service.clusters import ClusterProcesses, cluster_processes
from service.conftest import until
from service.databases import Postgres
from service.processes import ServiceProcess, children, runs, service_process
from service.sent_work import (
    Work,
    age_files,
    check_downloads,
    check_files,
    check_meshes,
    kill_at_work,
    lives,
    unfinished,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills are Linux's")
_PATIENCE = 300.0  # seconds; every worker that is started warms up


@dataclass
class Saboteur:
    """Kills parts while jobs arrive, by a seed, each time after a number of finished jobs, and starts them again."""

    service: ServiceProcess
    cluster: ClusterProcesses
    seed: int
    killed: Counter[str] = field(default_factory=Counter)
    processes: set[int] = field(default_factory=set)

    def rage(self, store: Store, jobs: int, deeds: list[str]) -> None:
        """Kill in a random order, spread over the work."""
        order = random.Random(self.seed)
        order.shuffle(deeds)
        for number, deed in enumerate(deeds):
            done = number * jobs // (2 * len(deeds))
            until(lambda done=done: store.queue.count().meshes["succeeded"] >= done, _PATIENCE)
            time.sleep(order.uniform(0.0, 0.3))
            self._kill(deed, order)
            self.killed[deed] += 1

    def _kill(self, deed: str, order: random.Random) -> None:
        self.processes.update(self.pool_processes())
        if deed == "process":
            os.kill(order.choice(until(self.pool_processes, _PATIENCE)), signal.SIGKILL)
        elif deed == "worker":
            name = order.choice([*self.cluster.workers])
            self.cluster.kill_worker(name, below=False)  # the processes of its pool end by themselves
            self.cluster.start_own_worker(name, slots=1)
        elif deed == "scheduler":
            self.cluster.kill_scheduler()
            time.sleep(order.uniform(0.0, 1.0))
            self.cluster.start_scheduler()
        else:
            self.service.kill()
            self.service.start()

    def pool_processes(self) -> list[int]:
        """The processes that solve."""
        below = [pid for worker in self.cluster.workers.values() for pid in children(worker.pid, deep=False)]
        return [pid for server in below for pid in children(server, deep=False)]


JOBS, WORKERS = 200, 2
DEEDS = {"process": 6, "worker": 3, "scheduler": 2, "service": 2}


# The loss of a process, of a worker and of the scheduler are in tests/service/engine/test_dask.py and in test_jobs.py,
# that of a service in tests/proofs/test_durability.py.
@pytest.mark.everything
def test_nothing_is_lost_while_parts_of_a_cluster_are_killed(tmp_path: Path, postgres: Postgres) -> None:
    files = tmp_path / "shared"
    with (
        postgres.database() as url,
        cluster_processes(tmp_path / "cluster") as cluster,
        service_process(
            tmp_path / "service",
            DATABASE_URL=url,
            FILES_URL=f"file://{files}",
            ENGINE="dask",
            SCHEDULER=cluster.scheduler,
            LEASE="3",
            WARM_UP="all",  # workers are killed while they start, too, which then takes long
        ) as service,
    ):
        cluster.start_scheduler()
        for number in range(WORKERS):
            cluster.start_own_worker(f"worker-{number}", slots=1)
        service.start()
        until(lambda: lives(service.url), _PATIENCE)
        service.ready()
        store = Store(url)
        try:
            work = Work(service.url, JOBS)
            saboteur = Saboteur(service, cluster, seed=JOBS)
            threads = work.start()
            kill_at_work(store, saboteur.pool_processes)
            saboteur.rage(store, JOBS, [deed for deed, times in DEEDS.items() for _ in range(times)])
            for thread in threads:
                thread.join()
            assert work.faults == []
            assert len(work.accepted) == JOBS
            assert saboteur.killed == DEEDS
            until(lambda: unfinished(store) == 0, _PATIENCE)
            assert service.stop() == 0  # a start sweeps files away that no mesh names
            age_files(url, files)
            service.start()
            service.ready()
            check_files(url, files)
            check_meshes(store, work)
            service.ready()  # the last deed may have been its end, when nothing was left to do
            check_downloads(service.url, store)
            assert service.stop() == 0
            cluster.close()
            until(lambda: not any(runs(pid) for pid in saboteur.processes))
        finally:
            store.close()
    assert not service.has_traceback
