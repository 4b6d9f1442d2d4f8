"""A running service: a mesh whose request waits goes straight to a worker, or stands in line for one."""

from __future__ import annotations

import asyncio
import gc
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import httpx

from equimesh_service.admission.intake import AcceptedMesh, Intake
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.errors import WorkerLostError
from service.conftest import small, until


def test_who_waits_goes_straight_to_a_worker(http: httpx.Client) -> None:
    def straight(**headers: str) -> bool:
        posted = http.post("/v1/meshes", json=small(label="straight"), headers=headers)
        mesh = http.get(f"{posted.headers['location']}?wait=30").json()
        return bool(mesh["started_at"] == mesh["created_at"])

    until(lambda: straight(Prefer="wait=30"))
    assert not straight()


def test_a_task_that_fails_after_the_wait_leaves_no_unread_error() -> None:
    async def told() -> list[dict[str, Any]]:
        said: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: said.append(context))
        none: Any = None
        settings: Any = SimpleNamespace(max_wait=30.0, poll=0.01)
        intake = Intake(settings, none, none, none, Wakeups(dict.fromkeys, 1.0), none)
        task: Future[Any] = Future()
        assert await intake.wait_for_ending(AcceptedMesh("a", task), 0.02) is None
        task.set_exception(WorkerLostError("it died"))
        await asyncio.sleep(0)
        gc.collect()
        return said

    assert asyncio.run(told()) == []


def test_both_ways_give_the_same_mesh(http: httpx.Client) -> None:
    def etag(headers: dict[str, str]) -> str:
        posted = http.post("/v1/meshes?format=npz", json=small(label="express"), headers=headers)
        mesh = http.get(f"{posted.headers['location']}?wait=30").json()
        events = http.get(mesh["links"]["events"], headers={"Accept": "application/json"}).json()["items"]
        assert [event["data"]["status"] for event in events if event["event"] != "progress"] == [
            *("queued", "running", "succeeded"),
        ]
        return http.get(mesh["links"]["file"], params={"format": "npz"}).headers["etag"]

    assert etag({"Prefer": "wait=30"}) == etag({})


def test_callers_beyond_the_workers_all_go_straight_to_one(http: httpx.Client) -> None:
    def straight(number: int) -> bool:
        mesh = http.post("/v1/meshes?reuse=false", json=small(label=str(number)), headers={"Prefer": "wait=30"}).json()
        return bool(mesh["started_at"] == mesh["created_at"])

    until(lambda: straight(-1))
    with ThreadPoolExecutor(8) as callers:
        assert sum(callers.map(straight, range(40))) >= 36  # a few may wait more than a second where all is slow
