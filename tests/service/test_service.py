"""A running service: a mesh whose request waits goes straight to a worker, or stands in line for one."""

from __future__ import annotations

import asyncio
import gc
import os
import time
from concurrent.futures import Future, ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from equimesh_service.admission import intake
from equimesh_service.admission.intake import AcceptedMesh, Intake
from equimesh_service.dispatch.dispatcher import Dispatcher
from equimesh_service.dispatch.wakeups import Wakeups
from equimesh_service.errors import WorkerLostError
from equimesh_service.store.rows import Claim
from service.conftest import SLOW, small, until


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
        mesh = http.get(f"{posted.headers['location']}?wait=30").json()
        events = http.get(mesh["links"]["events"], headers={"Accept": "application/json"}).json()["items"]
        assert [event["data"]["status"] for event in events if event["event"] != "progress"] == [
            *("queued", "running", "succeeded"),
        ]
        return http.get(mesh["links"]["file"], params={"format": "npz"}).headers["etag"]

    assert etag({"Prefer": "wait=30"}) == etag({})


def test_callers_beyond_the_workers_all_go_straight_to_one(http: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intake, "MAX_LINE_SECONDS", 60.0)  # else a busy machine sends some of them to the queue

    def straight(number: int) -> bool:
        mesh = http.post("/v1/meshes?reuse=false", json=small(label=str(number)), headers={"Prefer": "wait=30"}).json()
        return bool(mesh["started_at"] == mesh["created_at"])

    until(lambda: straight(-1))
    with ThreadPoolExecutor(8) as callers:
        assert all(callers.map(straight, range(40)))


def test_a_mesh_that_takes_longer_is_in_the_store_while_it_runs(http: httpx.Client) -> None:
    posted = http.post("/v1/meshes", json=SLOW, headers={"Prefer": "wait=1"})
    assert (posted.status_code, posted.json()["status"]) == (202, "running")
    mesh = http.get(posted.headers["location"]).json()
    assert mesh["started_at"] == mesh["created_at"]  # its worker had it before the store
    assert http.post(mesh["links"]["cancel"]).json()["status"] == "canceled"


def test_a_mesh_that_is_entered_while_it_runs_is_computed_once(http: httpx.Client) -> None:
    more = {"tolerance": None, "max_iterations": 8}
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
