"""Retries and waiting against a service that misbehaves, for both clients."""

from __future__ import annotations

import asyncio
import inspect
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from equimesh_client import (
    AsyncClient,
    AsyncMesh,
    Client,
    DeadlineExceeded,
    Mesh,
    MeshCanceled,
    MeshFailed,
    NotFound,
    ProblemError,
    QuotaExceeded,
    RateLimited,
    RetryPolicy,
    ServerError,
    ServiceUnreachable,
    StorageFull,
    Tensor,
    Unauthorized,
)
from equimesh_client.wire import flows

BIG = np.ones((60, 60))


def test_a_lost_upload_is_sent_again(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/samples", "lose")]
    mesh = connect(service.url).generate(monitor=Tensor(BIG, "0", 2 * BIG), n=8)
    assert (list(service.meshes), len(service.samples)) == ([mesh.id], 2)


def spec(**more: Any) -> dict[str, Any]:
    return {"monitor": {"u": {"expression": "x"}}, "grid": {"n_xi": 5, "n_eta": 4}, **more}


@pytest.mark.parametrize("action", ["drop", "lose", "status"])
def test_a_create_that_is_repeated_makes_one_mesh(connect: Any, service: Any, fault: Any, action: str) -> None:
    service.faults = [fault("POST /v1/meshes", action, times=2)]
    mesh = connect(service.url).generate("x*y", 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({request.headers["idempotency-key"] for request in sent}) == 1
    assert len({request.body for request in sent}) == 1
    assert list(service.meshes) == [mesh.id]


def test_a_create_with_samples_is_repeated_with_the_same_bytes_and_key(connect: Any, service: Any, fault: Any) -> None:
    client = connect(service.url)
    service.faults = [fault("POST /v1/samples", "lose"), fault("POST /v1/samples", "status")]
    stored = client.samples.upload(np.ones((60, 60)))
    assert list(service.samples) == [stored.id]
    service.faults = [fault("POST /v1/meshes", "lose"), fault("POST /v1/meshes", "status", status=429)]
    client.generate(np.ones((60, 60)), 5)
    sent = service.seen("POST", "meshes")
    assert len(sent) == 3
    assert len({(request.headers["idempotency-key"], request.body) for request in sent}) == 1
    assert sent[0].headers["content-type"].startswith("multipart/")
    assert len(service.meshes) == 1


def test_retry_after_is_honoured(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert connect(service.url).capabilities() == {"formats": ["vtu", "npz"]}
    assert time.monotonic() - start > 0.95


def test_a_long_retry_after_is_the_callers_to_wait_for(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited) as caught:
        connect(service.url).capabilities()
    assert caught.value.retry_after == 3600
    assert len(service.requests) == 1


def test_a_service_that_keeps_failing_is_given_up(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=502, times=99)]
    with pytest.raises(ServerError) as caught:
        connect(service.url).capabilities()
    assert caught.value.status == 502
    assert len(service.requests) == 4


@pytest.mark.parametrize(("status", "kind"), [(401, Unauthorized), (500, ServerError), (507, StorageFull)])
def test_what_does_not_get_better_is_not_repeated(
    connect: Any, service: Any, fault: Any, status: int, kind: type[ProblemError]
) -> None:
    service.faults = [fault("POST", "status", status=status, headers={"Retry-After": "1"})]
    with pytest.raises(kind):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 1


def test_a_quota_is_waited_for_as_long_as_it_is_short(connect: Any, service: Any, fault: Any) -> None:
    body = {"type": "/problems/quota-exceeded", "title": "Too much at a time"}
    service.faults = [fault("POST", "status", status=429, body=body, times=4)]
    with pytest.raises(QuotaExceeded):
        connect(service.url).generate("x", 5)
    assert len(service.requests) == 4


def test_nobody_there(connect: Any) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ServiceUnreachable, match="equimesh serve"):
            connect(url, retries=1).capabilities()


def test_a_service_without_tls(connect: Any, service: Any) -> None:
    with pytest.raises(ServiceUnreachable, match="give http:// if the service has no TLS"):
        connect(service.url.replace("http://", "https://"), retries=0).capabilities()


def test_somebody_else_there(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("capabilities", "status", status=200, body=["nothing"])]  # type: ignore[arg-type]
    with pytest.raises(ServiceUnreachable, match="not one of an equimesh service"):
        connect(service.url).capabilities()


def test_generate_cancels_what_nobody_waits_for(connect: Any, service: Any) -> None:
    for deadline in (0.4, 4.0, 40.0):  # a busy machine may need a while to send the request
        with pytest.raises(DeadlineExceeded):
            connect(service.url).generate("x", 5, label="hang", deadline=deadline)
        if service.meshes:
            break
    assert [mesh["status"] for mesh in service.meshes.values()] == ["canceled"]


def test_generate_cancels_a_mesh_whose_id_never_arrived(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes$", "late")]
    with pytest.raises(DeadlineExceeded):
        connect(service.url).generate("x", 5, label="hang", deadline=0.4)
    assert list(service.meshes) == ["m0"]
    assert service.meshes["m0"]["status"] == "canceled"


def test_a_deadline_ends_retries(connect: Any, service: Any, fault: Any) -> None:
    service.faults = [fault("POST /v1/meshes", times=999)]
    patient = RetryPolicy(retries=999, first=0.05, longest=0.05)
    with pytest.raises(DeadlineExceeded):
        connect(service.url, retries=patient).generate("x", 5, deadline=0.5)
    assert len(service.seen("POST", "meshes")) < 100  # 999 pauses would take 50 s


def test_a_cancel_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    service.faults = [fault("POST .*/cancel", "lose")]
    assert mesh.cancel().status == "canceled"
    assert len(service.seen("POST", "cancel")) == 2


def test_a_delete_whose_answer_was_lost(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("DELETE", "lose")]
    mesh.delete()
    with pytest.raises(NotFound):
        mesh.delete()
    with pytest.raises(NotFound):
        mesh.refresh()


# The outcome of a request: an exception, or a mesh for meshio.


def test_a_failed_mesh_says_why(connect: Any, service: Any) -> None:
    with pytest.raises(MeshFailed) as caught:
        connect(service.url).generate("x", 5, label="fail")
    assert str(caught.value) == "mesh m0 failed: Mesh folded. At cell 3. Lower a"
    assert caught.value.mesh.status == "failed"


def test_a_canceled_mesh_is_not_waited_for(connect: Any, service: Any) -> None:
    mesh = connect(service.url).meshes.create(spec(label="hang"))
    assert mesh.cancel().status == "canceled"
    with pytest.raises(MeshCanceled):
        mesh.wait()


def test_to_meshio_names_the_sides(connect: Any, service: Any) -> None:
    meshio = pytest.importorskip("meshio")
    made = connect(service.url).generate("x", (5, 4)).to_meshio()
    assert isinstance(made, meshio.Mesh)
    assert [(block.type, len(block.data)) for block in made.cells] == [
        ("quad", 12),
        ("line", 3),
        ("line", 3),
        ("line", 4),
        ("line", 4),
    ]
    assert set(made.cell_sets) == {"left", "right", "bottom", "top"}
    assert [len(part) for part in made.cell_sets["top"]] == [0, 0, 0, 0, 4]


# Event streams over connections that break, for both clients.


def test_events_come_once_each_over_dropped_connections(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [100, 130, 40]
    events = list(mesh.events(deadline=300))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [event.kind for event in events] == [kind for kind, _ in service.events]
    assert [event.data for event in events] == [data for _, data in service.events]
    requested = [request.headers.get("last-event-id") for request in service.seen("GET", "events")]
    assert requested[0] is None
    assert len(requested) == 4


@pytest.mark.parametrize("cut", [0, 1, 145, 290])
def test_events_survive_a_cut_anywhere(connect: Any, service: Any, cut: int) -> None:
    mesh = connect(service.url).meshes.create(spec())
    service.cuts = [cut]
    events = list(mesh.events(deadline=300))
    assert [event.id for event in events] == [1, 2, 3, 4, 5]
    assert [(event.kind, event.data) for event in events] == service.events


def test_events_start_where_asked(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    assert [event.id for event in mesh.events(after=3)] == [4, 5]
    assert list(mesh.events(after=5)) == []


def test_events_that_never_come_are_given_up(connect: Any, service: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(ServiceUnreachable, match="event stream"):
        list(mesh.events(deadline=300))


def test_events_have_a_deadline(connect: Any, service: Any) -> None:
    mesh = connect(service.url, retries=RetryPolicy(retries=99, first=0.1)).generate("x", 5)
    service.cuts = [0] * 99
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=0.5))


def test_events_of_no_mesh(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=404), fault("events", "status", status=503)]
    with pytest.raises(NotFound):
        list(mesh.events())
    assert len(list(mesh.events())) == 5


def test_events_come_back_when_the_service_says_so(connect: Any, service: Any, fault: Any) -> None:
    mesh = connect(service.url).generate("x", 5)
    service.faults = [fault("events", "status", status=503, headers={"Retry-After": "1"})]
    start = time.monotonic()
    assert len(list(mesh.events(deadline=300))) == 5
    assert time.monotonic() - start > 0.95
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "3600"})]
    with pytest.raises(RateLimited):
        list(mesh.events(deadline=9999))
    service.faults = [fault("events", "status", status=429, headers={"Retry-After": "30"})]
    with pytest.raises(DeadlineExceeded):
        list(mesh.events(deadline=10))


# Every wait ends with its deadline, whatever the service does: both twins, every method.


SPEC: dict[str, Any] = {"monitor": {"u": {"expression": "x"}}}
RECORD = {"id": "m", "status": "running"}
SECONDS = 0.5
LATE = 20.0  # less than a single read may take, and than all drips take; a busy machine may be late by seconds
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\n"
# What is sent at once, and what then drips, a byte at a time and each within the timeout of a single read.
BEHAVIOURS: dict[str, tuple[bytes, bytes]] = {
    "hangs": (b"", b""),
    "drips the head": (b"HTTP/1.1 200 OK\r\n", b"X-Drip: " + b"x" * 9999),
    "drips the body": (HEAD + b"Content-Length: 9999\r\n\r\n", b"x" * 9999),
    "drips chunks": (HEAD + b"Transfer-Encoding: chunked\r\n\r\n", b"1\r\n:\r\n" * 999),
    "drips inside a chunk": (HEAD + b"Transfer-Encoding: chunked\r\n\r\nfff\r\n", b":" * 4000),
}


class Dripper:
    """Takes connections and answers nothing, or a byte now and then."""

    def __init__(self, at_once: bytes, then: bytes) -> None:
        self.at_once, self.then = at_once, then
        self.closing = threading.Event()
        self.listener = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"
        self.threads = [threading.Thread(target=self.accept)]
        self.threads[0].start()

    def accept(self) -> None:
        while True:
            try:
                connection, _ = self.listener.accept()
            except OSError:
                return
            self.threads.append(threading.Thread(target=self.serve, args=(connection,)))
            self.threads[-1].start()

    def serve(self, connection: socket.socket) -> None:
        with connection:
            try:
                if self.at_once:
                    connection.sendall(self.at_once)
                for byte in self.then:
                    if self.closing.wait(0.1):
                        return
                    connection.sendall(bytes([byte]))
            except OSError:
                return
            self.closing.wait()

    def close(self) -> None:
        self.closing.set()
        self.listener.shutdown(socket.SHUT_RDWR)
        self.listener.close()
        for thread in self.threads:
            thread.join(timeout=300)


@pytest.fixture(params=list(BEHAVIOURS))
def url(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A service that does not get on."""
    monkeypatch.setattr(flows, "MAX_CANCEL_SECONDS", 0.1)  # of a generate, after its deadline
    dripper = Dripper(*BEHAVIOURS[request.param])
    yield dripper.url
    dripper.close()


LIBRARIES = ("skfem", "pyvista", "fipy", "mfem", "ngsolve", "sfepy")


def mesh_file(folder: Path) -> Path:
    """A file that takes a while to send."""
    path = folder / "mesh.msh"
    path.write_text("$MeshFormat\n" * 50_000)
    return path


def calls(client: Any, mesh: Any, folder: Path) -> dict[str, Callable[..., Any]]:
    """Everything public that waits, by name; each takes a deadline."""
    big = np.ones((400, 400))
    return {
        "generate": lambda **limit: client.generate("x", 5, **limit),
        "generate from samples": lambda **limit: client.generate(big, 5, **limit),
        "compute": lambda **limit: client.compute("x", 5, **limit),
        "compute_file": lambda **limit: client.compute_file("x.npz", "x", 5, **limit),
        "adapt": lambda **limit: client.adapt(lambda mesh: mesh.x, 5, **limit),
        "check": lambda **limit: client.check("x", **limit),
        "capabilities": client.capabilities,
        "meshes.create": lambda **limit: client.meshes.create(SPEC, **limit),
        "meshes.get": lambda **limit: client.meshes.get("m", **limit),
        "meshes.list": client.meshes.list,
        "samples.upload": lambda **limit: client.samples.upload(big, **limit),
        "samples.upload_mesh": lambda **limit: client.samples.upload_mesh(mesh_file(folder), **limit),
        "samples.get": lambda **limit: client.samples.get("s", **limit),
        "samples.delete": lambda **limit: client.samples.delete("s", **limit),
        "refresh": mesh.refresh,
        "wait": mesh.wait,
        "events": mesh.events,
        "cancel": mesh.cancel,
        "delete": mesh.delete,
        "quality_of_cells": mesh.quality_of_cells,
        "spec": mesh.spec,
        "download": lambda **limit: mesh.download(folder / "m.vtu", **limit),
        "download of parts": lambda **limit: mesh.download(folder / "m.xdmf", **limit),
        "download_parts": lambda **limit: mesh.download_parts(folder, **limit),
        "parts": mesh.parts,
        "part": lambda **limit: mesh.part(0, **limit),
        "arrays": mesh.arrays,
        "mesh_parts": mesh.mesh_parts,
        "to_meshio": mesh.to_meshio,
        **{f"to_{library}": getattr(mesh, f"to_{library}") for library in LIBRARIES},
        "to_dolfinx": lambda **limit: mesh.to_dolfinx(None, **limit),
        "to_dmplex": lambda **limit: mesh.to_dmplex(None, **limit),
        "plot": mesh.plot,
    }


def ended(name: str, started: float, error: BaseException | None) -> str | None:
    """What is wrong with the ending of a call."""
    took = time.monotonic() - started
    if not isinstance(error, DeadlineExceeded):
        return f"{name}: {error!r}"
    return None if SECONDS * 0.9 < took < SECONDS + LATE else f"{name}: {took:.2f} s"


def test_the_blocking_client_is_punctual(url: str, tmp_path: Path) -> None:
    with Client(url, timeout=300.0) as client:
        todo = calls(client, Mesh(client._session, RECORD), tmp_path)

        def one(name: str) -> str | None:
            started, error = time.monotonic(), None
            try:
                result = todo[name](deadline=SECONDS)
                list(result) if inspect.isgenerator(result) else None
            except Exception as caught:
                error = caught
            return ended(name, started, error)

        with ThreadPoolExecutor(len(todo)) as pool:
            assert [wrong for wrong in pool.map(one, todo) if wrong] == []


def test_the_client_for_asyncio_is_punctual(url: str, tmp_path: Path) -> None:
    async def everything() -> list[str | None]:
        async with AsyncClient(url, timeout=300.0) as client:
            mesh = AsyncMesh(client._session, RECORD)
            todo: dict[str, Any] = calls(client, mesh, tmp_path)
            todo |= {"quality": mesh.quality, "convergence": mesh.convergence}

            async def one(name: str) -> str | None:
                started, error = time.monotonic(), None
                try:
                    result = todo[name](deadline=SECONDS)
                    if inspect.isasyncgen(result):
                        async for _ in result:
                            pass
                    else:
                        await result
                except Exception as caught:
                    error = caught
                return ended(name, started, error)

            return await asyncio.gather(*map(one, todo))

    assert [wrong for wrong in asyncio.run(everything()) if wrong] == []


@pytest.mark.parametrize("kinds", [(Client, Mesh), (AsyncClient, AsyncMesh)])
def test_everything_that_waits_takes_a_deadline(kinds: tuple[type, type]) -> None:
    client = kinds[0]("http://127.0.0.1:9")
    offered = calls(client, kinds[1](client._session, RECORD), Path())
    for prefix, owner in (("", client), ("meshes.", client.meshes), ("samples.", client.samples), ("", kinds[1])):
        for name, member in inspect.getmembers(owner, inspect.isroutine):
            if name.startswith("_") or name == "close":
                continue
            kind = inspect.signature(member).parameters["deadline"]
            assert kind.kind is inspect.Parameter.KEYWORD_ONLY, name
            assert kind.annotation in ("float", "float | None"), name
            assert prefix + name in {*offered, "quality", "convergence"}, name
