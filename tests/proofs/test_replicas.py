"""Two services on one PostgreSQL and one folder of files share the work, and each takes over from the other.

The clock of one is an hour behind, that of the other an hour ahead.
"""

from __future__ import annotations

import re
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import httpx
import pytest
from sqlalchemy import make_url, text

from equimesh_service.store.store import Store
from service.conftest import PAPER, SLOW, small, until
from service.databases import Postgres
from service.processes import ServiceProcess, service_process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills are Linux's")
_LEASE = 15.0  # a replica renews it after a third, and may then be 10 s late on a busy machine
_HOUR = 3600.0
# The code that shifts the clock of a process, in seconds.
_SHIFTED = """\
import time

_real = time.time
time.time = lambda: _real() + {shift}
"""
# The transaction of a frozen replica is undone after this time, which is shorter than the usual one.
_IDLE_OPTION = "-c idle_in_transaction_session_timeout=4s"
_STARTS = re.compile(r"mesh (m-\w+) starts, attempt (\d+)")


def steady(iterations: int) -> dict[str, Any]:
    """A spec that takes at least some hundredths of a second for each iteration."""
    more = {**SLOW["schwarz"], "max_iterations": iterations}
    return {
        "monitor": {"kind": "arc_length", "u": {"expression": PAPER}},
        "grid": {"n_xi": 12, "n_eta": 12},
        "schwarz": more,
    }


def _also(url: str, option: str) -> str:
    """The address of a database, with one more option for its server."""
    address = make_url(url)
    options = {"options": f"{address.query['options']} {option}"}
    return address.update_query_dict(options).render_as_string(hide_password=False)


@dataclass(frozen=True)
class Pair:
    """Two replicas and their store."""

    a: ServiceProcess
    b: ServiceProcess
    store: Store

    def story(self, mesh_id: str) -> list[tuple[int, str, str]]:
        """The events of a mesh: their numbers, statuses and reasons."""
        events = self.store.meshes.events(mesh_id)
        assert [event.number for event in events] == [*range(1, len(events) + 1)]
        told = [event for event in events if event.kind != "progress"]
        return [(event.number, event.data["status"], event.data.get("reason", "")) for event in told]

    def states(self, mesh_id: str) -> list[str]:
        """The statuses of a mesh, in order."""
        return [state for _, state, _ in self.story(mesh_id)]

    def leases(self) -> list[float]:
        """The ends of the leases of running meshes."""
        with self.store.database.read() as connection:
            ends = connection.execute(text("SELECT lease_until FROM meshes WHERE status = 'running' ORDER BY id"))
            return [*ends.scalars()]


def begun(service: ServiceProcess) -> list[tuple[str, int]]:
    """The meshes that a replica has begun, with the numbers of the attempts."""
    return [(name, int(attempt)) for name, attempt in _STARTS.findall(service.log)]


def ask(service: ServiceProcess, spec: dict[str, Any], **headers: str) -> httpx.Response:
    """Request a mesh from a replica."""
    answer = httpx.post(f"{service.url}/v1/meshes?reuse=false", json=spec, headers=headers, timeout=600.0)
    assert answer.status_code in (201, 202), answer.text
    return answer


def look(service: ServiceProcess, mesh_id: str, query: str = "") -> dict[str, Any]:
    """A mesh as a replica shows it."""
    answer = httpx.get(f"{service.url}/v1/meshes/{mesh_id}{query}", timeout=600.0)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def finished(service: ServiceProcess, mesh_id: str) -> dict[str, Any]:
    """A finished mesh as a replica shows it."""
    found: dict[str, Any] = until(lambda: (mesh := look(service, mesh_id, "?wait=5"))["finished_at"] and mesh)
    return found


@pytest.fixture(scope="module")
def pair(postgres: Postgres, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Pair]:
    """Replicas of one worker each, with folders of their own next to that of the files."""
    folder = tmp_path_factory.mktemp("replicas")
    with postgres.database() as url:
        shared = {
            "DATABASE_URL": _also(url, _IDLE_OPTION),
            "FILES_URL": f"file://{folder / 'shared'}",
            "LEASE": str(_LEASE),
            "LOG_LEVEL": "info",
        }
        with (
            service_process(folder / "a", workers=1, first=_SHIFTED.format(shift=-_HOUR), **shared) as a,
            service_process(folder / "b", workers=1, first=_SHIFTED.format(shift=_HOUR), **shared) as b,
        ):
            a.start()
            b.start()
            a.ready()
            b.ready()
            store = Store(url)
            yield Pair(a, b, store)
            store.close()


def test_the_work_is_shared_and_each_mesh_is_begun_once(pair: Pair) -> None:
    names: list[str] = []

    def is_shared() -> bool:
        """Ask for one more, unless four wait or are computed: on a busy machine the queue would only grow."""
        if len(names) < 4 or look(pair.a, names[-4])["finished_at"]:
            names.append(ask(pair.a, steady(5)).json()["id"])
        return min(len(begun(pair.a)), len(begun(pair.b))) >= 2

    until(is_shared)
    assert {finished(pair.b, name)["status"] for name in names} == {"succeeded"}
    assert all(pair.states(name) == ["queued", "running", "succeeded"] for name in names)
    mine, others = begun(pair.a), begun(pair.b)
    assert sorted(mine + others) == sorted((name, 1) for name in names)


def test_wrong_clocks_are_reported_and_lose_nothing(pair: Pair) -> None:
    for service, words in ((pair.a, "s behind that of the database"), (pair.b, "s ahead of that of the database")):
        answer = httpx.get(f"{service.url}/readyz", timeout=600.0)
        assert answer.status_code == 200
        assert re.fullmatch(rf"this machine's clock is 3\d\d\d {words}", answer.json()["warnings"][0])
    names = [ask(pair.a, SLOW).json()["id"] for _ in range(2)]
    until(lambda: {look(pair.a, name)["status"] for name in names} == {"running"})
    with pair.a.frozen(pair.a.worker_pids()), pair.b.frozen(pair.b.worker_pids()):  # which would only compute
        for _ in range(2):  # at the second renewal, both have looked after leases that have expired
            before = pair.leases()
            until(lambda ends=before: all(now > end for now, end in zip(pair.leases(), ends, strict=True)))
    for name in names:
        mesh = look(pair.b, name)
        assert (mesh["status"], mesh["attempts"]) == ("running", 1)
        assert abs(datetime.fromisoformat(mesh["created_at"]).timestamp() - time.time()) < 600.0
        httpx.post(f"{pair.b.url}/v1/meshes/{name}/cancel", timeout=600.0)
        assert pair.states(name) == ["queued", "running", "canceled"]


def test_a_mesh_is_followed_waited_for_and_downloaded_through_the_other(pair: Pair) -> None:
    name = ask(pair.a, steady(20)).json()["id"]
    kinds: list[str] = []
    numbers: list[int] = []
    with httpx.stream("GET", f"{pair.b.url}/v1/meshes/{name}/events", timeout=600.0) as stream:
        for line in stream.iter_lines():
            field, _, value = line.partition(": ")
            kinds += [value] if field == "event" else []
            numbers += [int(value)] if field == "id" else []
    assert numbers == [*range(1, len(numbers) + 1)]
    assert (kinds[0], kinds[-1]) == ("status", "done")
    assert "progress" in kinds
    for service, other in ((pair.a, pair.b), (pair.b, pair.a)):
        name = ask(service, steady(2), Prefer="wait=300").json()["id"]
        assert look(other, name, "?wait=300")["status"] == "succeeded"
        for path in ("file", "file?format=vtu"):
            first, second = (httpx.get(f"{by.url}/v1/meshes/{name}/{path}", timeout=600.0) for by in (other, service))
            assert (first.status_code, first.headers["ETag"]) == (200, second.headers["ETag"])
            assert first.content == second.content


def test_a_mesh_is_canceled_and_deleted_through_the_other(pair: Pair) -> None:
    for service, other in ((pair.a, pair.b), (pair.b, pair.a)):
        answers: list[httpx.Response] = []
        waiting = threading.Thread(
            target=lambda to=service, told=answers: told.append(ask(to, SLOW, Prefer="wait=300"))
        )
        waiting.start()  # where somebody waits, it is this replica that computes
        name = until(lambda by=other: _running(by))
        assert httpx.post(f"{other.url}/v1/meshes/{name}/cancel").json()["status"] == "canceled"
        waiting.join()
        assert answers[0].json()["status"] == "canceled"
        # The worker has noticed, too, since there is no other that could do this.
        assert ask(service, steady(2), Prefer="wait=300").json()["status"] == "succeeded"
        assert httpx.delete(f"{other.url}/v1/meshes/{name}").status_code == 204
        assert httpx.get(f"{service.url}/v1/meshes/{name}").status_code == 404


def _running(service: ServiceProcess) -> str | None:
    items = httpx.get(f"{service.url}/v1/meshes?status=running").json()["items"]
    return items[0]["id"] if items and items[0]["progress"]["phase"] else None


@pytest.mark.everything  # it stops and starts both
def test_a_rolling_restart_loses_nothing(pair: Pair) -> None:
    names: list[str] = []
    over = threading.Event()

    def client() -> None:
        turn = 0
        while not over.is_set():
            turn += 1
            key = {"Idempotency-Key": f"rolling-{turn}"}
            for service in (pair.a, pair.b) * 50:
                try:
                    names.append(ask(service, small(), **key).json()["id"])
                except httpx.TransportError:
                    time.sleep(0.1)  # that one is down: the other answers
                    continue
                break
            time.sleep(0.2)

    thread = threading.Thread(target=client)
    thread.start()
    try:
        for service in (pair.a, pair.b):
            until(lambda: len(names) % 7 == 3)
            assert service.stop() == 0
            service.start()
            service.ready()
    finally:
        over.set()
        thread.join()
    assert len(names) == len({*names}) > 5
    for name in names:
        assert finished(pair.a, name)["status"] == "succeeded"
        told = pair.story(name)
        assert {reason for _, _, reason in told} <= {"", "the service was stopped"}
        assert [state for _, state, _ in told][-2:] == ["running", "succeeded"]


def test_what_a_silent_replica_had_is_taken_over_and_not_taken_back(pair: Pair) -> None:
    name = _begun_by(pair, pair.a)
    with pair.a.frozen():
        until(lambda: look(pair.b, name)["attempts"] == 2)
        mesh = finished(pair.b, name)
    assert (mesh["status"], mesh["attempts"]) == ("succeeded", 2)
    # The frozen worker continues with its mesh, or is stopped and takes another.
    assert ask(pair.a, steady(2), Prefer="wait=300").json()["status"] == "succeeded"
    assert pair.states(name) == ["queued", "running", "queued", "running", "succeeded"]
    assert pair.story(name)[2][2] == "its service stopped responding"
    assert look(pair.a, name) == mesh


@pytest.mark.everything  # as the one before, with a process that is gone
def test_what_a_killed_replica_had_is_taken_over(pair: Pair) -> None:
    name = _begun_by(pair, pair.a)
    pair.a.kill()
    began = time.monotonic()
    until(lambda: look(pair.b, name)["attempts"] == 2)
    assert time.monotonic() - began > _LEASE / 2  # not before the lease, of which a third is gone at most
    assert finished(pair.b, name)["status"] == "succeeded"
    assert pair.states(name) == ["queued", "running", "queued", "running", "succeeded"]
    assert pair.story(name)[2][2] == "its service stopped responding"
    until(lambda: not pair.a.left())
    assert pair.b.stop() == 0
    until(lambda: not pair.b.left())


def _begun_by(pair: Pair, service: ServiceProcess) -> str:
    """A mesh that this replica computes, some seconds long."""
    threading.Thread(target=lambda: _ask_in_vain(service), daemon=True).start()
    name: str = until(lambda: _running(pair.b))
    assert (name, 1) in begun(service)
    return name


def _ask_in_vain(service: ServiceProcess) -> None:
    try:
        ask(service, steady(150), Prefer="wait=1")
    except httpx.TransportError:
        return  # it is killed meanwhile
