"""Recovery: from killed workers, killed services, limits of time and memory."""

from __future__ import annotations

import gc
import json
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from equimesh_client import Client, RetryPolicy
from equimesh_service import Settings, running
from equimesh_service.dispatch.dispatcher import Dispatcher, Rules
from equimesh_service.engine.port import Health
from equimesh_service.engine.processes import ProcessEngine
from equimesh_service.errors import FolderInUseError, TimeLimitError, WorkerLostError
from equimesh_service.service import PRELOAD
from equimesh_service.store.rows import Claim, NewMesh
from equimesh_service.store.store import Store
from service.conftest import SLOW, small, until
from service.engine.check_engine import add, allocate
from service.processes import ServiceProcess, children, command_of, runs, service_process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="kills and limits are Linux's")
SPEC: dict[str, Any] = {"label": None, "grid": {"n_xi": 8, "n_eta": 8}, "cells": "quad"}
# Seconds without an event: each of its iterations factorises large matrices again and again.
DEEP: dict[str, Any] = {**SLOW, "grid": {"n_xi": 140, "n_eta": 140}}
DEEP["schwarz"] = {**SLOW["schwarz"], "subdomains": [2, 1]}


def die(marker: str) -> None:
    """A task that kills its worker, and counts how often it began."""
    with Path(marker).open("a") as file:
        file.write("x")
    os.kill(os.getpid(), signal.SIGKILL)


def die_once(marker: str, url: str, claim: Claim) -> None:
    """A task that kills its worker the first time, and succeeds the second."""
    if not Path(marker).exists():
        die(marker)
    store = Store(url)
    store.queue.finish(claim)
    store.close()


def test_a_killed_worker_does_not_lose_its_mesh(tmp_path: Path, database_url: str) -> None:
    store, engine = Store(database_url), ProcessEngine(1, preload=PRELOAD)
    store.prepare()
    marker = str(tmp_path / "marker")
    dispatcher = Dispatcher(
        "me", store, engine, lambda claim, _: (die_once, (marker, database_url, claim)), Rules(), lambda _: None
    )
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert (row.status, row.attempt) == ("succeeded", 2)
        story = [(event.kind, event.data.get("status"), event.data.get("reason")) for event in store.meshes.events("a")]
        assert story[2] == ("status", "queued", "the worker process died")
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


def test_a_mesh_that_kills_its_workers_fails_after_three(tmp_path: Path) -> None:
    store, engine = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}"), ProcessEngine(1, preload=PRELOAD)
    store.prepare()
    marker = tmp_path / "marker"
    dispatcher = Dispatcher("me", store, engine, lambda *_: (die, (str(marker),)), Rules(), lambda _: None)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert row.status == "failed"
        assert row.error["type"] == "/problems/worker-lost"
        assert "3 attempts" in row.error["detail"]
        assert marker.read_text() == "xxx"
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


class Sluggish:
    """An engine in which a mesh is canceled at the very moment that its task is submitted."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.canceled: list[Future[Any]] = []

    def submit(self, function: Any, *arguments: Any, time_limit: float | None = None) -> Future[Any]:
        assert (function, arguments, time_limit) == (add, (1, 1), 300.0)
        assert self.store.queue.cancel("a")
        return Future()

    def cancel(self, task: Future[Any]) -> None:
        self.canceled.append(task)
        if not task.done():
            task.set_exception(CancelledError())

    def health(self) -> Health:
        return Health(ready=True, workers=1)

    def close(self) -> None:
        raise AssertionError


def test_a_cancel_between_claim_and_submission_is_seen(tmp_path: Path) -> None:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    store.prepare()
    engine = Sluggish(store)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher = Dispatcher("me", store, engine, lambda *_: (add, (1, 1)), Rules(), lambda _: None)
    dispatcher.start(alone=True)
    try:
        until(lambda: engine.canceled)
    finally:
        dispatcher.stop()
        store.close()


def _busiest(processes: list[int], is_over: Callable[[], object] = lambda: False) -> int | None:
    """The first process that works for a fifth of a second from now on, however long it waits for a processor.

    None where ``is_over`` becomes true before.
    """
    before = {pid: _cpu_ticks(pid) for pid in processes}
    needed = os.sysconf("SC_CLK_TCK") // 5
    found: list[int] = until(
        lambda: [pid for pid in processes if _cpu_ticks(pid) - before[pid] >= needed] or (is_over() and [0])
    )
    return found[0] or None


def _cpu_ticks(pid: int) -> int:
    """Processor time of a process until now, in ticks of the clock; 0 where it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0
    return int(fields[11]) + int(fields[12])


@pytest.mark.parametrize(
    ("function", "arguments", "seconds", "name", "words"),
    [
        (allocate, (1000,), 60.0, "memory-limit", "64 MiB"),
        (time.sleep, (60,), 0.4, "time-limit", "0.4 s"),
        (add, (1, 1), 60.0, "internal-error", ""),
    ],
)
def test_a_job_that_breaks_a_limit_fails_and_says_so(
    tmp_path: Path, function: Any, arguments: tuple[Any, ...], seconds: float, name: str, words: str
) -> None:
    store = Store(f"sqlite:///{tmp_path / 'a.sqlite3'}")
    engine = ProcessEngine(1, memory_limit=64, preload=PRELOAD)
    store.prepare()
    rules = Rules(time_limit=seconds, memory_limit=64)
    dispatcher = Dispatcher("me", store, engine, lambda *_: (function, arguments), rules, lambda _: None)
    store.meshes.add(NewMesh(id="a", spec=SPEC))
    dispatcher.start(alone=True)
    try:
        row = until(lambda: (row := store.meshes.get("a")) and row.finished and row)
        assert (row.status, row.error["type"], row.attempt) == ("failed", f"/problems/{name}", 1)
        assert words in row.error["detail"]
    finally:
        dispatcher.stop()
        engine.close()
        store.close()


def test_the_limit_of_the_queue_and_a_stop_of_the_service(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, port=0, workers=1, log_level="error", max_queue=2)
    with running(settings) as url, httpx.Client(base_url=url, timeout=600.0) as http:
        with pytest.raises(FolderInUseError), running(settings):
            pass
        last = http.post("/v1/meshes", json=SLOW).json()
        until(lambda: http.get(last["links"]["self"]).json()["status"] == "running")
        waiting = [http.post("/v1/meshes", json=small(), headers={"Idempotency-Key": f"k{n}"}) for n in range(2)]
        assert [answer.status_code for answer in waiting] == [202, 202]
        for headers in ({}, {"Idempotency-Key": "new"}):
            full = http.post("/v1/meshes", json=small(), headers=headers)
            assert (full.status_code, full.json().get("type")) == (429, "/problems/queue-full")
        again = http.post("/v1/meshes", json=small(), headers={"Idempotency-Key": "k1"})  # whose answer was lost
        assert (again.status_code, again.headers["location"]) == (202, waiting[1].headers["location"])
        other = http.post("/v1/meshes", json=small(label="x"), headers={"Idempotency-Key": "k1"})
        assert (other.status_code, other.json()["type"]) == (422, "/problems/idempotency-key-reused")
    store = Store(settings.database)
    row, events = store.meshes.get(last["id"]), store.meshes.events(last["id"])
    store.close()
    assert row.status == "queued"
    assert events[-1].data == {"status": "queued", "reason": "the service was stopped"}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """A service as a process, in a folder of its own; tests find it running or not, and leave it so."""
    folder = tmp_path_factory.mktemp("served") / "service"
    with service_process(folder, workers=1, LEASE="60", MAX_POINTS="1000000", MAX_WAIT="600") as service:
        yield service


def _run(service: ServiceProcess) -> None:
    """Start it where it does not run, and wait until it is ready."""
    if not service.runs:
        service.start()
    service.ready()


def test_a_killed_service_goes_on_where_it_was(served: ServiceProcess) -> None:
    """Its client tries again until it is there: before it is ready for the first time, too, and while it is down."""
    served.start()
    patient = RetryPolicy(retries=3000, first=0.1, longest=0.1)
    with Client(served.url, retries=patient) as client:
        mesh = client.meshes.create(SLOW, deadline=300.0)
        until(lambda: mesh.refresh(deadline=300.0).progress.phase)
        workers = served.worker_pids()
        served.kill()
        until(lambda: not any(runs(pid) for pid in workers))  # nobody computes for a dead service
        served.start()
        until(lambda: mesh.refresh(deadline=300.0).attempts == 2)  # at once, whatever its lease was
        assert mesh.cancel(deadline=300.0).status == "canceled"


UNSTORED = "/v1/meshes?store=false&format=npz"


def _answered(http: httpx.Client) -> bool:
    """Whether the worker, or the one in its place, computes the next mesh."""
    return http.post(UNSTORED, json=small()).status_code == 200


def _answer_with(http: httpx.Client, pids: list[int], signal_number: int, wait: int) -> httpx.Response:
    """The answer with a mesh that is not kept, whose worker gets a signal while it works.

    On a busy machine the time may be over before it has worked: then the next request waits twice as long.
    """
    answers: list[httpx.Response] = []

    def ask() -> None:
        answers.append(http.post(UNSTORED, json=SLOW, headers={"Prefer": f"wait={wait}"}))

    thread = threading.Thread(target=ask)
    thread.start()
    worker = _busiest(pids, lambda: answers)
    if worker is not None:
        os.kill(worker, signal_number)
    thread.join()
    return answers[0] if worker is not None else _answer_with(http, pids, signal_number, 2 * wait)


@pytest.mark.parametrize(
    ("signal_number", "wait", "status", "problem"),
    [(signal.SIGKILL, 60, 503, "/problems/unavailable"), (signal.SIGSTOP, 5, 409, "/problems/time-limit")],
)
def test_a_worker_that_is_lost_over_a_mesh_that_is_not_kept_is_replaced(
    served: ServiceProcess, signal_number: int, wait: int, status: int, problem: str
) -> None:
    _run(served)
    with httpx.Client(base_url=served.url, timeout=120.0) as http:
        until(lambda: _answered(http))
        before, pids = http.get("/v1/meshes").json()["items"], served.worker_pids()
        answer = _answer_with(http, pids, signal_number, wait)
        assert (answer.status_code, answer.json()["type"]) == (status, problem)
        until(lambda: not all(map(runs, pids)))  # also the one that the system has stopped
        until(lambda: _answered(http))
        assert http.get("/v1/meshes").json()["items"] == before


def test_the_work_on_a_mesh_that_is_not_kept_ends_when_its_caller_leaves(served: ServiceProcess) -> None:
    _run(served)
    with httpx.Client(base_url=served.url, timeout=120.0) as http:
        until(lambda: _answered(http))
        pids, body = served.worker_pids(), json.dumps(DEEP)
        with socket.create_connection(("127.0.0.1", served.port)) as caller:
            head = f"POST {UNSTORED} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
            caller.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n{body}".encode())
            worker = _busiest(pids)
        assert worker is not None
        until(lambda: not runs(worker))
        until(lambda: _answered(http))


def test_a_stop_answers_everybody_and_hands_back_what_was_computed(served: ServiceProcess) -> None:
    _run(served)
    with httpx.Client(base_url=served.url, timeout=600.0) as http:
        spec = {"monitor": {"kind": "weight", "rho": "1"}, "grid": {"n_xi": 300, "n_eta": 300}}
        made = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()["links"]["file"]
        big = f"{made}?format=su2"
        assert len(http.get(big).content) > 6_000_000  # more than the 4 MB that a connection buffers
        mesh = http.post("/v1/meshes", json=SLOW).json()["links"]["self"]
        until(lambda: http.get(mesh).json()["progress"]["phase"])
    answers: dict[str, int] = {}

    def follow(path: str) -> None:
        answers[path] = httpx.get(served.url + path, timeout=100.0).status_code

    paths = (f"{mesh}?wait=600", f"{mesh}/events")
    threads = [threading.Thread(target=follow, args=(path,)) for path in paths]
    for thread in threads:
        thread.start()
    with _reading_nothing(served.port, big):
        until(lambda: _connections(served.port) == 3)
        time.sleep(0.5)
        served.signal(signal.SIGINT)
        time.sleep(0.2)
        # A second signal does no harm; it would wait in vain for an end that waits for who reads nothing.
        assert served.stop() == 0
    for thread in threads:
        thread.join()
    assert answers == dict.fromkeys(paths, 200)  # neither waited for the whole time
    store = Store(f"sqlite:///{served.folder / 'data' / 'equimesh.sqlite3'}")
    row = store.meshes.get(mesh.rpartition("/")[2])
    events = store.meshes.events(mesh.rpartition("/")[2])
    assert (row.status, row.attempt) == ("queued", 1)
    assert events[-1].data == {"status": "queued", "reason": "the service was stopped"}
    assert store.meshes.delete(row.id, lambda _: None)
    store.close()
    _check_nothing_is_left(served)


def test_a_service_that_is_stopped_as_it_starts_its_workers_leaves_nothing(served: ServiceProcess) -> None:
    if served.runs:
        served.stop()
    served.folder.mkdir(exist_ok=True)
    (served.folder / "log").write_text("")
    served.start()
    until(lambda: children(served.pid))
    assert served.stop() == 0
    _check_nothing_is_left(served)
    assert "Traceback" not in served.log


def _check_nothing_is_left(service: ServiceProcess) -> None:
    """At the end itself all is gone but Python's tracker of named resources, which ends when nobody holds it."""
    assert [
        command for command in map(command_of, service.left()) if command and "resource_tracker" not in command
    ] == []
    until(lambda: not service.left())


def _connections(port: int) -> int:
    """The number of connections to a service from which it has read all that came."""
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    of_service = [(state, queue) for _, local, _, state, queue, *_ in lines if local.endswith(f":{port:04X}")]
    return sum(state == "01" and queue.endswith(":00000000") for state, queue in of_service)


@contextmanager
def _reading_nothing(port: int, path: str) -> Iterator[None]:
    """A download by a client that has stopped reading."""
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", port))
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        assert client.recv(15) == b"HTTP/1.1 200 OK"
        yield


@pytest.mark.parametrize("method", ["POST", "DELETE"])
def test_a_factorisation_is_ended_by_a_cancel(http: httpx.Client, settings: Settings, method: str) -> None:
    answers: list[httpx.Response] = []
    wait = {"Prefer": "wait=300"}  # so it goes straight to a worker

    def left() -> set[Path]:
        return {*(settings.data_dir / "files" / "unfinished").iterdir()}

    before = left()  # by workers that other tests have killed
    thread = threading.Thread(target=lambda: answers.append(httpx.post(url, json=DEEP, headers=wait, timeout=600.0)))
    url = f"{http.base_url}/v1/meshes"
    thread.start()
    mesh = until(lambda: http.get("/v1/meshes?status=running").json()["items"])[0]["links"]["self"]
    until(lambda: http.get(mesh).json()["progress"]["phase"])  # a worker has it; one that was replaced warms up first
    time.sleep(0.5)
    workers = [pid for pid in children(os.getpid()) if runs(pid)]
    answer = http.request(method, f"{mesh}/cancel" if method == "POST" else mesh)
    assert answer.is_success
    # Nothing else ends one that is inside a factorisation; where it is not there yet, it ends by itself.
    until(lambda: answers or not all(runs(pid) for pid in workers))
    thread.join()
    assert answers[0].status_code == (201 if method == "POST" else 404)  # one that waits for its whole time is a 202
    if method == "DELETE":
        assert http.get(mesh).status_code == 404
        until(lambda: left() <= before)
    again = http.post("/v1/meshes", json=small(), headers=wait).json()
    assert again["status"] == "succeeded"


def half(size: int) -> None:
    """A task that ends its worker while it sends its answer."""
    gc.unfreeze()  # a worker hides what it has from the collector, and from the next line
    (channel,) = (found for found in gc.get_objects() if type(found) is socket.socket and found.fileno() >= 0)
    channel.sendall(size.to_bytes(8, "little") + b"x")
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    """A task that ends its worker with exit code 0."""
    os._exit(0)


@pytest.mark.parametrize(("function", "arguments"), [(half, (1000,)), (leave, ())])
def test_a_worker_that_dies_at_the_worst_moment_does_not_stop_the_others(
    function: Any, arguments: tuple[Any, ...]
) -> None:
    engine = ProcessEngine(2, preload=PRELOAD)
    try:
        assert engine.wait_until_ready(300.0)
        slow = engine.submit(time.sleep, 1.0)
        assert isinstance(engine.submit(function, *arguments).exception(300.0), WorkerLostError)
        assert engine.submit(add, 1, 1).result(300.0) == 2
        assert slow.exception(300.0) is None
        assert _is_sound(engine)
    finally:
        engine.close()


def test_a_worker_that_the_system_stops_is_killed_at_the_limit() -> None:
    engine = ProcessEngine(1, preload=PRELOAD)
    try:
        assert engine.wait_until_ready(300.0)
        pid = engine.submit(os.getpid).result(300.0)
        os.kill(pid, signal.SIGSTOP)
        assert isinstance(engine.submit(add, 1, 1, time_limit=0.5).exception(300.0), TimeLimitError)
        until(lambda: not runs(pid))
        assert engine.submit(add, 1, 1).result(300.0) == 2
    finally:
        engine.close()


def refuse() -> None:
    """What a worker raises that cannot read its task."""
    raise ImportError("this release does not know it")


class Unreadable:
    """An argument that no worker can read."""

    def __reduce__(self) -> tuple[Any, ...]:
        return (refuse, ())


def test_a_task_that_no_worker_can_read_says_so_and_nothing_is_lost() -> None:
    engine = ProcessEngine(1, preload=PRELOAD)
    try:
        assert engine.wait_until_ready(300.0)
        pid = engine.submit(os.getpid).result(300.0)
        assert isinstance(engine.submit(add, 1, Unreadable()).exception(300.0), ImportError)
        assert engine.submit(os.getpid).result(300.0) == pid
    finally:
        engine.close()


def _is_sound(engine: ProcessEngine) -> bool:
    """Whether a time limit holds, for which the pool must work."""
    return isinstance(engine.submit(time.sleep, 60.0, time_limit=0.1).exception(300.0), TimeLimitError)
