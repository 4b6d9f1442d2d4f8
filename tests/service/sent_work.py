"""Jobs that clients send while parts of the service are killed, and the checks that nothing was lost."""

from __future__ import annotations

import hashlib
import io
import json
import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from sqlalchemy import select, update

from equimesh_service.files.folder import FolderFiles
from equimesh_service.store.blobs import BlobFiles
from equimesh_service.store.database import Database
from equimesh_service.store.schema import artifacts, blobs, meshes, samples
from equimesh_service.store.store import Store
from service.conftest import PAPER, until

_CLIENTS = 4
# Settings of a mesh that takes seconds.
SLOW = {"transmission": {"kind": "classical"}, "tolerance": None, "max_iterations": 1000, "subdomains": [4, 1]}
PATIENCE = 300.0  # seconds; for one request, over all its repetitions
_HOURS = 8 * 3600.0


@dataclass
class Work:
    """Jobs that clients send, each until it is accepted, with the answers."""

    url: str
    jobs: int
    accepted: dict[int, str] = field(default_factory=dict)
    repeated: int = 0
    faults: list[str] = field(default_factory=list)
    _left: queue.SimpleQueue[int] = field(default_factory=queue.SimpleQueue)

    def __post_init__(self) -> None:
        for job in range(self.jobs):
            self._left.put(job)

    def start(self) -> list[threading.Thread]:
        """Clients at work."""
        threads = [threading.Thread(target=self._client) for _ in range(_CLIENTS)]
        for thread in threads:
            thread.start()
        return threads

    def _client(self) -> None:
        with httpx.Client(base_url=self.url, timeout=300.0) as http:
            while True:
                try:
                    job = self._left.get_nowait()
                except queue.Empty:
                    return
                self._send(http, job)

    def _send(self, http: httpx.Client, job: int) -> None:
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            try:
                answer = http.post("/v1/meshes?reuse=false", **_request(job))
            except httpx.TransportError:
                self.repeated += 1
                time.sleep(0.05)
                continue
            if answer.status_code in (201, 202):
                self.accepted[job] = answer.headers["Location"].rpartition("/")[2]
                return
            if answer.status_code not in (429, 503):
                self.faults.append(f"job {job}: {answer.status_code} {answer.text}")
                return
            time.sleep(0.05)
        self.faults.append(f"job {job} was never accepted")


def _request(job: int) -> dict[str, Any]:
    """One of four ways to request a mesh of 8 x 8 points; every job has its own mesh, and the first one takes long."""
    spec: dict[str, Any] = {
        "monitor": {"kind": "arc_length", "u": {"expression": PAPER}, "a": 0.5 + job / 1000},
        "grid": {"n_xi": 8, "n_eta": 8},
        "label": f"job {job}",
    }
    if job == 0:
        spec |= {"grid": {"n_xi": 33, "n_eta": 33}, "schwarz": SLOW}
    headers = {"Idempotency-Key": f"job-{job}"}
    match job % 4:
        case 0:
            return {"json": spec, "headers": headers}
        case 1:
            return {"json": spec, "headers": {**headers, "Prefer": "wait=10"}}
        case 2:
            return {"json": spec, "headers": {**headers, "Prefer": "wait=10", "Accept": "application/x-npz"}}
        case _:
            spec["monitor"]["u"] = {"samples": "upload"}
            return {
                "data": {"spec": json.dumps(spec)},
                "files": {"samples": ("u.npz", _samples(job))},
                "headers": headers,
            }


def _samples(job: int) -> bytes:
    x = np.linspace(0.0, 1.0, 9)
    with io.BytesIO() as file:
        np.savez(file, x=x, y=x, values=np.tanh(np.add.outer((job % 3 + 2.0) * x, x)))
        return file.getvalue()


def lives(url: str) -> bool:
    try:
        return httpx.get(f"{url}/livez").status_code == 200
    except httpx.TransportError:
        return False


def kill_at_work(store: Store, processes: Callable[[], list[int]]) -> None:
    """Kill the processes of workers while one of them has a mesh at work, so that this mesh begins again.

    A mesh is "running" from its lease on, which may be before it has reached a process. A process that is
    killed then costs nothing. One whose request waits is not in the store for 200 ms, and the first one takes seconds.
    So this is repeated, each time later, until a mesh began twice.
    """

    def running() -> set[str]:
        return {row.id for row in store.meshes.page(status="running", limit=1000)}

    pause, deadline = 0.25, time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        until(running, PATIENCE)
        held = until(processes, PATIENCE)
        _signal(held, signal.SIGSTOP)
        time.sleep(pause)
        names = running()
        _signal(held, signal.SIGKILL)
        if names and max(until(partial(_attempts_after, store, names), PATIENCE)) > 1:
            return
        pause *= 2
    raise AssertionError("no mesh was begun twice")


def _signal(pids: list[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def _attempts_after(store: Store, names: set[str]) -> list[int]:
    """The attempts of the meshes that began again or ended."""
    rows = [row for row in store.meshes.page(limit=1000) if row.id in names]
    return [row.attempt for row in rows if row.attempt > 1 or row.status not in ("queued", "running")]


def unfinished(store: Store) -> int:
    census = store.queue.count().meshes
    return census["queued"] + census["running"]


def check_meshes(store: Store, work: Work) -> None:
    """One mesh for each job, each with complete events: as many starts as attempts, and one end."""
    rows = store.meshes.page(limit=10 * work.jobs)
    assert sorted(row.label or "" for row in rows) == sorted(f"job {job}" for job in range(work.jobs))
    assert {row.id for row in rows} == {*work.accepted.values()}
    assert any(row.attempt > 1 for row in rows), "no mesh was begun twice: this proves nothing"
    for row in rows:
        events = store.meshes.events(row.id)
        assert [event.number for event in events] == [*range(1, row.last_event + 1)]
        assert [event.kind for event in events].count("done") == 1
        assert (events[-1].kind, events[-1].data["status"]) == ("done", row.status)
        states = [event.data["status"] for event in events if event.kind == "status"]
        assert states == ["queued", "running"] * row.attempt
        if row.status == "failed":
            assert row.error["type"] == "/problems/worker-lost", row.error
            assert row.attempt >= 3
        else:
            assert row.status == "succeeded"


def check_downloads(url: str, store: Store) -> None:
    """The file of every successful mesh exists, and matches its ETag."""
    with httpx.Client(base_url=url, timeout=300.0) as http:
        for row in store.meshes.page(status="succeeded", limit=1000):
            answer = http.get(f"/v1/meshes/{row.id}/file?format=npz")
            assert answer.status_code == 200
            assert answer.headers["ETag"] == f'"{hashlib.sha256(answer.content).hexdigest()}"'
            with np.load(io.BytesIO(answer.content)) as file:
                assert file["x"].shape == ((33, 33) if row.label == "job 0" else (8, 8))


def check_files(url: str, folder: Path) -> None:
    """The files are exactly those that rows name; none is half written."""
    named = set()
    database = Database(url)
    files = BlobFiles(database, FolderFiles(folder))
    with database.read() as connection:
        for column in (artifacts.c.sha256, samples.c.sha256):
            named.update(connection.execute(select(column)).scalars())
        assert connection.execute(select(meshes.c.id).where(meshes.c.owner.is_not(None))).first() is None
    until(lambda: {file.sha256 for file in files.listing()} == named)
    database.close()
    # Temporary files and folders from before the start are gone; newer ones may be in use.
    left = [path for path in (folder / "unfinished").iterdir() if time.time() - path.stat().st_mtime > _HOURS / 2]
    assert left == []


def age_files(url: str, folder: Path) -> None:
    """Make all files look hours old: the sweep leaves young files, which may still be named."""
    with closing(Database(url)) as database, database.write() as connection:
        connection.execute(update(blobs).values(created_at=blobs.c.created_at - _HOURS))
    for path in folder.glob("*/*"):
        os.utime(path, (time.time() - _HOURS, time.time() - _HOURS))
