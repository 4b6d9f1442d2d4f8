"""A service whose meshes are solved on a cluster of processes: what holds with its own workers holds there."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from equimesh_service import Settings, running
from service.clusters import ClusterProcesses, cluster_processes
from service.conftest import SLOW, small, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of memory and kills are Linux's")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClusterProcesses]:
    """A scheduler and one worker with two processes for jobs, started by the commands of the compose file."""
    with cluster_processes(tmp_path_factory.mktemp("cluster")) as cluster:
        cluster.start_scheduler()
        cluster.start_own_worker("worker")
        yield cluster


@pytest.fixture(scope="module")
def http(cluster: ClusterProcesses, tmp_path_factory: pytest.TempPathFactory) -> Iterator[httpx.Client]:
    """A client of a service on the cluster."""
    settings = Settings(
        data_dir=tmp_path_factory.mktemp("service"),
        port=0,
        engine="dask",
        scheduler=cluster.scheduler,
        log_level="info",
        reuse=False,
    )
    with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as client:
        yield client


def ask(http: httpx.Client, spec: dict[str, Any], **headers: str) -> dict[str, Any]:
    answer = http.post("/v1/meshes", json=spec, headers=headers)
    assert answer.status_code in (201, 202), answer.text
    found: dict[str, Any] = answer.json()
    return found


def mesh_of(http: httpx.Client, mesh_id: str) -> dict[str, Any]:
    found: dict[str, Any] = http.get(f"/v1/meshes/{mesh_id}").json()
    return found


def test_a_mesh_is_solved_there_and_its_files_are_here(cluster: ClusterProcesses, http: httpx.Client) -> None:
    mesh = ask(http, small(), Prefer="wait=300")
    assert until(lambda: mesh_of(http, mesh["id"])["finished_at"])
    assert mesh_of(http, mesh["id"])["status"] == "succeeded"
    assert http.get(f"{mesh['links']['file']}?format=npz").content.startswith(b"PK")
    log = cluster.log("worker")
    assert log.count(f"mesh {mesh['id']} succeeded") == 1, "another process has solved it"


def test_the_health_checks_of_the_compose_file_tell_who_lives(cluster: ClusterProcesses, http: httpx.Client) -> None:
    assert http.get("/livez").status_code == 200  # the service has seen both
    assert cluster.is_healthy("scheduler")
    assert cluster.is_healthy("worker", "worker")
    cluster.health_ports["none"] = 9
    assert not cluster.is_healthy("worker", "none")


def test_readiness_and_metrics_count_the_places_of_the_cluster(http: httpx.Client) -> None:
    end = time.monotonic() + 300.0
    while (ready := http.get("/readyz")).status_code != 200 and time.monotonic() < end:
        time.sleep(0.5)  # on a busy machine a part may not answer within the 5 s that it has
    assert (ready.status_code, ready.json()["checks"]["engine"]) == (200, "ok")
    assert 'equimesh_workers{pool="solve"} 2.0' in http.get("/metrics").text


def test_progress_is_told_and_a_cancelled_mesh_ends_within_a_second(http: httpx.Client) -> None:
    mesh = ask(http, SLOW)
    until(lambda: mesh_of(http, mesh["id"])["progress"]["phase"])
    assert http.post(mesh["links"]["cancel"]).json()["status"] == "canceled"
    # Its process takes the next mesh: there are two, and three meshes that do not end by themselves.
    slow = [ask(http, SLOW) for _ in range(2)]
    for one in slow:
        until(lambda one=one: mesh_of(http, one["id"])["status"] == "running")
        http.post(one["links"]["cancel"])


def test_requests_that_wait_are_answered_when_their_mesh_is_done(http: httpx.Client) -> None:
    answers: list[dict[str, Any]] = []
    threads = [threading.Thread(target=lambda: answers.append(ask(http, small(), Prefer="wait=300"))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 8
    assert all(until(lambda one=one: mesh_of(http, one["id"])["status"] == "succeeded") for one in answers)


def test_without_the_scheduler_readiness_names_it_and_meshes_wait(
    cluster: ClusterProcesses, http: httpx.Client
) -> None:
    running = ask(http, SLOW)
    until(lambda: mesh_of(http, running["id"])["status"] == "running")
    cluster.kill_scheduler()  # the last test: it does not come back
    until(lambda: mesh_of(http, running["id"])["status"] == "queued")
    ready = until(lambda: (answer := http.get("/readyz")).status_code == 503 and answer)
    assert ready.json()["checks"]["engine"].startswith(f"the scheduler at {cluster.scheduler} cannot be reached")
    assert {name for name, said in ready.json()["checks"].items() if said != "ok"} == {"engine"}
    waiting = ask(http, small(), Prefer="wait=1")
    assert (waiting["status"], waiting["attempts"]) == ("queued", 0)
    assert http.get("/metrics").text.count('equimesh_workers{pool="solve"} 0.0') == 1
    for one in (running, waiting):
        assert http.post(one["links"]["cancel"]).json()["status"] == "canceled"
