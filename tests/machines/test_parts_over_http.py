"""Meshes in parts over HTTP: a service whose cluster computes them, and both of its ways to fail."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

import equimesh as em
from equimesh_client import ArcLength, Client
from equimesh_cluster import connect, read_parts
from equimesh_service import Settings, running
from service.clusters import ClusterProcesses, cluster_processes
from service.conftest import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills are Linux's")
U = "tanh(10*(x + y/2 - 0.75))"
SPEC: dict[str, Any] = {"monitor": {"kind": "arc_length", "u": U}, "grid": {"n_xi": 225, "n_eta": 161}}
# A solve of many seconds: of millions of points.
LONG: dict[str, Any] = {"monitor": {"kind": "curvature", "u": U}, "grid": {"n_xi": 3073, "n_eta": 2049}}


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClusterProcesses]:
    """A scheduler and two workers."""
    with cluster_processes(tmp_path_factory.mktemp("cluster")) as cluster:
        cluster.start_scheduler()
        for name in ("one", "two"):
            cluster.start_worker(name, "--no-nanny")
        yield cluster


@pytest.fixture(scope="module")
def url(cluster: ClusterProcesses, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A service on the cluster, whose limit of one machine is small."""
    settings = Settings(
        data_dir=tmp_path_factory.mktemp("service"),
        port=0,
        engine="dask",
        scheduler=cluster.scheduler,
        max_points=20_000,
        max_cluster_points=10_000_000,
        time_limit=600.0,
        lease=2.0,
        log_level="info",
    )
    with running(settings) as url:
        # A mesh that is begun with one worker has one part.
        until(lambda: 'equimesh_workers{pool="solve"} 2.0' in httpx.get(f"{url}/metrics").text)
        yield url


@pytest.fixture(scope="module")
def http(url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=url, timeout=600.0) as client:
        yield client


def boxes(dask_worker: Any) -> int:
    """The number of parts that run on a worker."""
    plugin = dask_worker.plugins.get("equimesh-messages")
    return 0 if plugin is None else len(plugin.boxes)


@pytest.fixture(scope="module")
def watcher(cluster: ClusterProcesses) -> Iterator[Any]:
    """A client of the cluster that looks at its workers."""
    with connect(cluster.scheduler) as client:
        yield client


def running_parts(watcher: Any) -> int:
    """The number of parts that run on the cluster."""
    return sum(watcher.run(boxes).values())


def kept_results(watcher: Any) -> int:
    """The number of results that stay on the cluster."""
    return sum(map(len, watcher.has_what().values()))


def ask(http: httpx.Client, spec: dict[str, Any]) -> dict[str, Any]:
    answer = http.post("/v1/meshes", json=spec)
    assert answer.status_code in (201, 202), answer.text
    found: dict[str, Any] = answer.json()
    return found


def look(http: httpx.Client, mesh: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = http.get(f"/v1/meshes/{mesh['id']}", params={"wait": 1}).json()
    return found


def test_a_mesh_over_the_limit_is_that_of_one_process_in_parts(url: str, watcher: Any, tmp_path: Path) -> None:
    with Client(url) as client:
        mesh = client.generate(U, (225, 161), monitor=ArcLength(), deadline=600.0)
        expected = em.solve(em.Problem(monitor=em.ArcLength(u=em.Expression(U)), grid=em.Grid(n_xi=225, n_eta=161)))
        for suffix in ("pvtu", "vtkhdf"):
            found = read_parts(mesh.download_parts(tmp_path, suffix))
            np.testing.assert_allclose(found.rows("x", 0, 225), expected.mesh.x, rtol=0.0, atol=1e-13)
            np.testing.assert_allclose(found.rows("y", 0, 225), expected.mesh.y, rtol=0.0, atol=1e-13)
        assert read_parts(mesh.download(tmp_path / "mine.pvtu")).cuts == found.cuts
        part, listed = mesh.part(1), mesh.parts()
        np.testing.assert_array_equal(part.x, found.rows("x", part.first, 225))
        assert part.u is not None
        np.testing.assert_allclose(part.u, np.tanh(10 * (part.x + part.y / 2 - 0.75)), rtol=1e-12)
        assert (listed.count, tuple(listed.grid), listed.parts[-1].last) == (2, (225, 161), 225)
        assert mesh.certificate.status == str(expected.status) == "converged"
        said, known = mesh.record["certificate"], expected.certificate.summary()
        assert said["interpolation_gain"]["l2"] == pytest.approx(known["interpolation_gain"]["l2"], rel=1e-9)
        assert said["warnings"] == known["warnings"]
        assert mesh.quality.q_eq.max == pytest.approx(expected.quality.q_eq.max, rel=1e-9)
        record = mesh.record
        assert record["parts"]["count"] == 2
        assert record["parts"]["attempts"] == 1
        assert record["convergence"]["traffic"] == record["parts"]["bytes"]
        assert mesh.spec()["parts"] == "auto"
        again = client.generate(U, (225, 161), monitor=ArcLength())
        assert again.reused_from == mesh.id
        shared = again.parts().head
        assert (shared.name, shared.sha256) == (listed.head.name, listed.head.sha256)
    assert until(lambda: kept_results(watcher) == 0)


def test_a_cancelled_mesh_leaves_nothing_on_the_workers(http: httpx.Client, watcher: Any) -> None:
    mesh = ask(http, LONG)
    until(lambda: running_parts(watcher) == 2)
    assert http.post(mesh["links"]["cancel"]).json()["status"] == "canceled"
    until(lambda: running_parts(watcher) == 0)
    until(lambda: kept_results(watcher) == 0)


def test_what_the_grid_cannot_have_is_said(http: httpx.Client) -> None:
    mesh = ask(http, {**SPEC, "parts": 4000})
    ended = until(lambda: (found := look(http, mesh))["status"] == "failed" and found)
    assert ended["error"]["type"] == "/problems/invalid-input"
    assert ended["error"]["errors"][0]["pointer"] == "/parts"
    refused = http.get(f"{mesh['links']['self']}/parts")
    assert (refused.status_code, refused.json()["type"]) == (422, "/problems/invalid-input")


@pytest.mark.everything
def test_a_lost_worker_costs_no_mesh(http: httpx.Client, cluster: ClusterProcesses) -> None:
    mesh = ask(http, {**SPEC, "grid": {"n_xi": 1281, "n_eta": 1025}})
    until(lambda: look(http, mesh)["status"] != "queued")
    cluster.kill_worker("two")
    cluster.start_worker("three", "--no-nanny")
    deadline = time.monotonic() + 300.0
    while not (found := look(http, mesh))["finished_at"]:
        assert time.monotonic() < deadline
    assert found["status"] == "succeeded", found["error"]
    manifest = http.get(found["links"]["parts"]).json()
    assert manifest["parts"][-1]["last"] == 1281
