"""Every wait ends with its deadline, whatever the service does: both twins, every method."""

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

from equimesh_client import AsyncClient, AsyncMesh, Client, DeadlineExceeded, Mesh
from equimesh_client.wire import flows

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
            thread.join(timeout=10)


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
    with Client(url, timeout=30.0) as client:
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
        async with AsyncClient(url, timeout=30.0) as client:
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
