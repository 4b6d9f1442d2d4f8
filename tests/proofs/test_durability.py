"""Durability: jobs arrive while workers and services are killed, and nothing is lost."""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from equimesh_service.store.database import sqlite_file
from equimesh_service.store.store import Store
from service.conftest import until
from service.processes import ServiceProcess, service_process
from service.sent_work import (
    PATIENCE,
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


class Saboteur:
    """Kills workers and services while jobs arrive: by a seed, each time after a number of accepted jobs."""

    def __init__(self, service: ServiceProcess, seed: int) -> None:
        self.service = service
        self.random = random.Random(seed)
        self.killed = {"worker": 0, "service": 0}

    def rage(self, work: Work, deeds: list[str]) -> None:
        """Kill in a random order, spread over the work."""
        self.random.shuffle(deeds)
        moments = sorted(self.random.sample(range(work.jobs // 20, work.jobs), len(deeds)))
        for deed, moment in zip(deeds, moments, strict=True):
            until(lambda moment=moment: len(work.accepted) + len(work.faults) >= moment, PATIENCE)
            time.sleep(self.random.uniform(0.0, 0.1))
            if deed != "service":
                self.kill_a_worker()
            if deed != "worker":
                self.service.kill()
                self.service.start()
                self.killed["service"] += 1

    def kill_a_worker(self) -> None:
        """Kill one, if there is one: just after a start of the service there is none."""
        pids = until(self.service.worker_pids, PATIENCE)
        try:
            os.kill(self.random.choice(pids), signal.SIGKILL)
        except ProcessLookupError:
            return
        self.killed["worker"] += 1


@pytest.mark.parametrize(
    ("database_url", "jobs", "deeds"),
    [
        ("sqlite", 12, {"both": 1}),
        pytest.param("sqlite", 200, {"worker": 10, "service": 2, "both": 1}, marks=pytest.mark.everything),
        pytest.param("postgresql", 60, {"worker": 5, "both": 1}, marks=pytest.mark.everything),
    ],
    indirect=["database_url"],
)
def test_nothing_is_lost_while_workers_and_services_are_killed(
    tmp_path: Path, database_url: str, jobs: int, deeds: dict[str, int], everything: bool
) -> None:
    with service_process(tmp_path / "service", DATABASE_URL=database_url, LEASE="3") as service:
        service.start()
        work = Work(service.url, jobs)
        saboteur = Saboteur(service, seed=jobs)
        until(lambda: lives(service.url), PATIENCE)
        service.ready()
        with closing(Store(database_url)) as store:
            threads = work.start()
            kill_at_work(store, service.worker_pids)
            saboteur.rage(work, [deed for deed, times in deeds.items() for _ in range(times)])
            for thread in threads:
                thread.join()
            assert work.faults == []
            assert len(work.accepted) == jobs
            assert saboteur.killed["service"] == sum(times for deed, times in deeds.items() if deed != "worker")
            assert saboteur.killed["worker"] >= deeds.get("worker", 1)
            assert work.repeated > 0, "no request was cut off: this proves nothing"

            until(lambda: unfinished(store) == 0, PATIENCE)
            if everything:  # a start sweeps files away that no mesh names
                assert service.stop() == 0
                age_files(database_url, service.folder / "data" / "files")
                service.start()
                service.ready()
                check_files(database_url, service.folder / "data" / "files")
            check_meshes(store, work)
            check_downloads(service.url, store)
            assert service.stop() == 0
            until(lambda: not service.left())
    file = sqlite_file(database_url)
    if file is not None:
        with sqlite3.connect(file) as connection:
            assert connection.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        connection.close()
    assert not service.has_traceback
