"""The engine on a cluster keeps the contract of the engine port, on processes that come and go."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from pathlib import Path

import pytest

from equimesh_service.engine.dask import DaskEngine
from equimesh_service.engine.port import PackedCall, PoolSettings
from equimesh_service.errors import SchedulerLostError, WorkerLostError
from service.clusters import ClusterProcesses, cluster_processes
from service.conftest import until
from service.engine.check_engine import SECONDS, add, check_engine, expect_closed, own_pid, sit, spin
from service.processes import children, free_port, runs

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and kills are Linux's")
SETTINGS = PoolSettings(memory_limit=128)
OLDER = """\
import importlib.metadata as metadata
real = metadata.version
metadata.version = lambda name: "0.1.0" if name == "equimesh" else real(name)
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClusterProcesses]:
    """A scheduler and a worker with two processes for jobs, which lives under a nanny, as Dask's usual workers do."""
    with cluster_processes(tmp_path_factory.mktemp("cluster")) as cluster:
        cluster.start_scheduler()
        start_first(cluster)
        yield cluster


def start_first(cluster: ClusterProcesses) -> None:
    # Its nanny starts it again at its address.
    cluster.start_worker("first", "--worker-port", str(free_port()), slots=2)


@contextmanager
def engine_on(cluster: ClusterProcesses, settings: PoolSettings = SETTINGS) -> Iterator[DaskEngine]:
    """An engine that is closed after the ``with``."""
    engine = DaskEngine(cluster.scheduler, settings)
    try:
        yield engine
    finally:
        engine.close()


def begun(engine: DaskEngine, marker: Path, endless: Callable[[str], None] = sit) -> tuple[Future[None], int]:
    """A task that does not end, and the process that runs it."""
    task = engine.submit(endless, str(marker))
    until(lambda: marker.exists() and marker.read_text())
    return task, int(marker.read_text())


def test_a_cluster_keeps_the_contract(cluster: ClusterProcesses, tmp_path: Path) -> None:
    with engine_on(cluster) as engine:
        until(lambda: engine.health().ready)
        assert engine.health().workers == 2
        check_engine(engine, tmp_path, memory_limit=128)
    expect_closed(engine)


def test_workers_join_and_leave_and_take_their_jobs_with_them(cluster: ClusterProcesses, tmp_path: Path) -> None:
    with engine_on(cluster) as engine:
        until(lambda: engine.health().workers == 2)
        before = [begun(engine, tmp_path / f"before{number}") for number in range(2)]
        waiting = engine.submit(own_pid)
        time.sleep(0.5)
        assert not waiting.done(), "it has no process yet, so it waits"
        cluster.start_worker("second", "--no-nanny")
        assert waiting.result(SECONDS) not in [pid for _, pid in before]
        assert engine.health().workers == 3
        task, pid = begun(engine, tmp_path / "second")
        left = engine.submit(own_pid)
        cluster.kill_worker("second")
        assert isinstance(task.exception(SECONDS), WorkerLostError)
        until(lambda: not runs(pid))
        assert engine.health().workers == 2
        assert not left.done()
        engine.cancel(before[0][0])
        assert left.result(SECONDS) not in [pid, before[1][1]]
    assert isinstance(before[1][0].exception(SECONDS), CancelledError)
    until(lambda: not runs(before[1][1]))  # an engine that is closed leaves no job behind


def test_a_job_is_not_begun_again_by_the_worker_that_takes_the_place_of_a_lost_one(
    cluster: ClusterProcesses, tmp_path: Path
) -> None:
    marker = tmp_path / "marker"
    with engine_on(cluster) as engine:
        until(lambda: engine.health().ready)
        first, pid = begun(engine, marker, spin)
        (worker,) = [pid for pid in children(cluster.workers["first"].pid, deep=False) if children(pid)]
        os.kill(worker, signal.SIGKILL)
        os.kill(pid, signal.SIGKILL)  # its one call lets no other thread look for the end of the worker
        assert isinstance(first.exception(SECONDS), WorkerLostError)
        assert engine.submit(add, 1, 2).result(SECONDS) == 3
        assert marker.read_text() == str(pid), "another process has begun it, too"


def test_a_lost_scheduler_gives_back_what_runs_and_what_waits_waits(cluster: ClusterProcesses, tmp_path: Path) -> None:
    with engine_on(cluster) as engine:
        until(lambda: engine.health().workers == 2)
        running = [begun(engine, tmp_path / f"running{number}") for number in range(2)]
        waiting = engine.submit(add, 1, 2)
        cluster.kill_scheduler()
        for task, pid in running:
            assert isinstance(task.exception(SECONDS), SchedulerLostError)
            until(lambda pid=pid: not runs(pid))
        until(lambda: engine.health().detail.startswith(f"the scheduler at {cluster.scheduler} cannot be reached"))
        assert not waiting.done()
        assert engine.health().workers == 0
        cluster.kill_worker("first")
        cluster.start_scheduler()
        until(lambda: engine.health().detail.endswith("there are no workers"))
        start_first(cluster)
        assert waiting.result(SECONDS) == 3
        assert engine.health().ready


def test_a_worker_of_another_release_is_refused_by_name(cluster: ClusterProcesses, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(OLDER)
    path = os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])
    with engine_on(cluster) as engine:
        cluster.start_worker("old", "--no-nanny", PYTHONPATH=path)
        until(lambda: "old" in engine.health().detail and engine.health().ready)
        assert "worker old is not used: it has equimesh 0.1.0 in place of" in engine.health().detail
        assert engine.health().workers == 2
        cluster.kill_worker("old")
        until(lambda: engine.health().detail == "")


def nothing_is_reached() -> str:
    """A check that fails."""
    return "it cannot reach the moon"


def test_a_worker_that_does_not_reach_the_storage_is_refused(cluster: ClusterProcesses) -> None:
    with engine_on(cluster, PoolSettings(check=PackedCall.of(nothing_is_reached))) as engine:
        until(lambda: "the moon" in engine.health().detail)
        assert engine.health().detail.endswith("worker first is not used: it cannot reach the moon")
        assert not engine.health().ready
