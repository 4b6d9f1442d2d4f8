"""A running service: a mesh whose request waits goes straight to a worker, or stands in line for one."""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from equimesh_service import Settings, service
from equimesh_service.admission import intake
from equimesh_service.admission.intake import AcceptedMesh, Intake
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.engine.port import Health
from equimesh_service.errors import ClusterMissingError, WorkerLostError
from equimesh_service.service import check_cluster, pool_settings
from equimesh_service.store.rows import Claim
from equimesh_service.worker import warmth
from equimesh_service.worker.job import Storage
from equimesh_service.worker.rare_loops import RareLoops
from service.conftest import SLOW, small, until


def test_who_waits_goes_straight_to_a_worker(http: httpx.Client) -> None:
    def straight(**headers: str) -> bool:
        posted = http.post("/v1/meshes", json=small(label="straight"), headers=headers)
        mesh = http.get(f"{posted.headers['location']}?wait=300").json()
        return bool(mesh["started_at"] == mesh["created_at"])

    until(lambda: straight(Prefer="wait=300"))
    assert not straight()


def test_a_task_that_fails_after_the_wait_leaves_no_unread_error() -> None:
    async def told() -> list[dict[str, Any]]:
        said: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(context))
        none: Any = None
        settings: Any = SimpleNamespace(max_wait=30.0, poll=0.01)
        waiting = Intake(settings, none, none, none, Wakeups(dict.fromkeys, 1.0), none, none, none, none)
        task: Future[Any] = Future()
        assert await waiting.wait_for_ending(AcceptedMesh("a", task), 0.02) is None
        task.set_exception(WorkerLostError("it died"))
        await asyncio.sleep(0)
        gc.collect()
        return said

    assert asyncio.run(told()) == []


def test_both_ways_give_the_same_mesh(http: httpx.Client) -> None:
    def etag(headers: dict[str, str]) -> str:
        posted = http.post("/v1/meshes?format=npz", json=small(label="express"), headers=headers)
        mesh = http.get(f"{posted.headers['location']}?wait=300").json()
        events = http.get(mesh["links"]["events"], headers={"Accept": "application/json"}).json()["items"]
        assert [event["data"]["status"] for event in events if event["event"] != "progress"] == [
            *("queued", "running", "succeeded")
        ]
        return http.get(mesh["links"]["file"], params={"format": "npz"}).headers["etag"]

    assert etag({"Prefer": "wait=300"}) == etag({})


def test_callers_beyond_the_workers_all_go_straight_to_one(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intake, "MAX_LINE_SECONDS", 60.0)  # else a busy machine sends some of them to the queue

    def straight(number: int) -> bool:
        mesh = http.post("/v1/meshes?reuse=false", json=small(label=str(number)), headers={"Prefer": "wait=300"}).json()
        return bool(mesh["started_at"] == mesh["created_at"])

    until(lambda: straight(-1))
    with ThreadPoolExecutor(8) as callers:
        assert all(callers.map(straight, range(16)))


def test_a_mesh_that_takes_longer_is_in_the_store_while_it_runs(http: httpx.Client) -> None:
    posted = http.post("/v1/meshes", json=SLOW, headers={"Prefer": "wait=1"})
    assert (posted.status_code, posted.json()["status"]) == (202, "running")
    mesh = http.get(posted.headers["location"]).json()
    assert mesh["started_at"] == mesh["created_at"]  # its worker had it before the store
    assert http.post(mesh["links"]["cancel"]).json()["status"] == "canceled"


def test_a_mesh_that_is_entered_while_it_runs_is_computed_once(http: httpx.Client) -> None:
    more = {"tolerance": None, "max_iterations": 4}
    spec = {**SLOW, "label": "entered", "schwarz": {**SLOW["schwarz"], **more}}
    posted = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=60"})
    mesh = http.get(f"{posted.headers['location']}?wait=60").json()
    events = http.get(mesh["links"]["events"], headers={"Accept": "application/json"}).json()["items"]
    kinds = [event["event"] for event in events]
    assert "progress" in kinds
    assert [kind for kind in kinds if kind != "progress"] == ["status", "status", "done"]
    assert (mesh["attempts"], mesh["started_at"]) == (1, mesh["created_at"])


@pytest.mark.parametrize("is_lost", [True, False], ids=["lost", "stuck"])
def test_a_request_whose_worker_is_lost_or_stuck_enters_the_queue(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch, is_lost: bool
) -> None:
    begin = Dispatcher.begin_request

    def lost(self: Dispatcher, claim: Claim, _: Any, *__: Any) -> Future[Any]:
        return begin(self, claim, os._exit, 1) if is_lost else begin(self, claim, time.sleep, 3600.0)

    monkeypatch.setattr(Dispatcher, "begin_request", lost)
    posted = http.post("/v1/meshes?reuse=false", json=small(label="lost"), headers={"Prefer": "wait=1"})
    mesh = http.get(f"{posted.headers['location']}?wait=60").json()
    assert (mesh["status"], mesh["attempts"]) == ("succeeded", 1)
    assert mesh["started_at"] > mesh["created_at"]  # through the queue


def test_a_cluster_without_dask_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with_cluster = Settings(engine="dask", scheduler="tcp://host:8786", data_dir=tmp_path)
    check_cluster(with_cluster)
    monkeypatch.setattr(service, "find_spec", lambda _: None)
    check_cluster(Settings(data_dir=tmp_path))
    with pytest.raises(ClusterMissingError, match=r"pip install 'equimesh\[dask\]'"):
        check_cluster(with_cluster)


def test_a_service_loads_none_of_the_packages_of_other_extras() -> None:
    others = ("dask", "distributed", "obstore", "opentelemetry.sdk", "psycopg", "sphinx", "zarr")
    code = f"import sys\nsys.modules.update(dict.fromkeys({others}))\nimport equimesh_service.server\n"
    # What is loaded when it starts is as little as it needs: the solver comes with the first check in the process.
    code += "assert not {'numba', 'scipy', 'h5py', 'meshio', 'matplotlib'} & sys.modules.keys()\n"
    code += f"import {', '.join(service.WARM_PRELOAD[:-1])}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_services_with_the_same_limits_share_the_pools_of_workers(tmp_path: Path) -> None:
    address = service.files_address(Settings(data_dir=tmp_path))
    (tmp_path / "files").mkdir()
    storage = Storage(f"sqlite:///{tmp_path / 'a.sqlite3'}", address)

    def name(**more: int) -> str:
        return pool_settings(Settings(engine="dask", scheduler="tcp://host:8786", **more), storage).name

    assert name() == name(workers=3)
    assert name() != name(memory_limit=100)


def test_workers_warm_up_unless_the_settings_say_otherwise(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    storage = Storage(f"sqlite:///{tmp_path / 'a.sqlite3'}", service.files_address(Settings(data_dir=tmp_path)))
    warm, cold = (pool_settings(Settings(warm_up=how), storage) for how in ("all", "none"))
    assert warm.warm_up is not None
    assert cold.warm_up is None
    assert set(warm.preload) - set(cold.preload) >= {"equimesh_service.worker.warm_fork"}


def test_workers_of_a_cluster_compile_all_loops_and_others_begin_with_the_basic_ones() -> None:
    ways = (Settings(warm_up="all"), Settings(warm_up="all", engine="dask", scheduler="tcp://host:8786"))
    assert [service._start_of_workers(way)[1] for way in ways] == [service.WARM_UP_BASICS, service.WARM_UP]
    assert all(
        callable(getattr(warmth, way.name.partition(":")[2])) for way in (service.WARM_UP_BASICS, service.WARM_UP)
    )


def test_a_service_that_is_ready_says_how_far_the_rest_is() -> None:
    count: Any = SimpleNamespace(latest=lambda: {"compiled": 53, "of": 153})
    loops = RareLoops(lambda: True, dict)
    ready, starting = (
        SimpleNamespace(health=lambda found=found: Health(ready=found, workers=2)) for found in (True, False)
    )
    engine: Any
    for engine, loops.are_compiling, is_told in ((starting, False, True), (ready, True, True), (ready, False, False)):
        assert (service._warm_up(Settings(), engine, loops, count) is not None) == is_told
