"""A full disk, and one that takes no writes: real ones. The service says so, loses nothing, and goes on afterwards."""

from __future__ import annotations

import asyncio
import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import text

from equimesh_service import Settings
from equimesh_service.api.app import create_app
from service.conftest import small

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="file systems of a chosen size are mounted")
_LEAVE_LOG = """
import os, sqlite3, sys
sqlite3.connect(sys.argv[1]).execute("SELECT * FROM sqlite_master").fetchone()
os._exit(0)
"""
INSIDE = "EQUIMESH_TEST_MAY_MOUNT"


def may_mount(folder: Path) -> bool:
    """Whether this process can mount a file system."""
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder], capture_output=True)
    if done.returncode == 0:
        subprocess.run(["umount", folder], check=True)
    return done.returncode == 0


@contextmanager
def disk(folder: Path, size: str) -> Iterator[Path]:
    """A small disk."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def fill(folder: Path) -> Path:
    """Take all the room there is; the file that is removed to give it back."""
    path = folder / "ballast"
    with path.open("wb", buffering=0) as file:
        for size in (4096, 1):
            try:
                while True:
                    file.write(b"x" * size)
            except OSError:
                continue
    return path


async def read_only(folder: Path, wanted: bool) -> None:
    """Make a disk take no writes, or take them again; it must not be written to at this moment."""
    deadline = time.monotonic() + 300.0
    while True:
        done = subprocess.run(["mount", "-o", f"remount,{'ro' if wanted else 'rw'}", folder], capture_output=True)
        if done.returncode == 0:
            return
        assert time.monotonic() < deadline, done.stderr
        await asyncio.sleep(0.02)


def test_the_service_outlives_its_disks(tmp_path: Path) -> None:
    if os.environ.get(INSIDE) or may_mount(tmp_path):
        with disk(tmp_path / "data", "12m") as data, disk(tmp_path / "files", "2m") as files:
            asyncio.run(_outlive(data, files))
        return
    # Not root: a namespace of its own, in which everybody may mount.
    again = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"{__file__}::{_name()}"]
    done = subprocess.run(["unshare", "--map-root-user", "--mount", *again], env={**os.environ, INSIDE: "1"})
    assert done.returncode == 0


def _name() -> str:
    return test_the_service_outlives_its_disks.__name__


async def _outlive(data: Path, files: Path) -> None:
    settings = Settings(
        data_dir=data,
        files_url=files.as_uri(),
        port=0,
        workers=1,
        log_level="error",
        poll=1.0,
        lease=300.0,
        reuse=False,
    )
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://localhost", timeout=90.0) as http:
            mesh = await _mesh(http)
            assert mesh["status"] == "succeeded", mesh["error"]
            await _full_files(http, files, mesh)
            await _files_without_writes(http, files, mesh)
            await _full_database(http, data)
            await _database_without_writes(http, data, app.state.service, mesh)


async def _mesh(http: httpx.AsyncClient, wait: int = 30, **more: Any) -> dict[str, Any]:
    answer = await http.post("/v1/meshes", json=small(**more), headers={"Prefer": f"wait={wait}"})
    mesh: dict[str, Any] = answer.json()
    while answer.status_code in (200, 202) and mesh["finished_at"] is None:
        answer = await http.get(mesh["links"]["self"] + "?wait=30")
        mesh = answer.json()
    return mesh


async def _upload(http: httpx.AsyncClient, seed: int) -> httpx.Response:
    rows = "".join(f"{i % 100},{i // 100},{i * seed}.25\n" for i in range(10_000))
    return await http.post("/v1/samples", content=rows.encode(), headers={"Content-Type": "text/csv"})


def _expect(answer: httpx.Response, status: int, name: str) -> None:
    assert (answer.status_code, answer.json().get("type")) == (status, f"/problems/{name}"), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    for told in ("Traceback", "sqlite", "/files", "tmp"):
        assert told not in answer.text


async def _full_files(http: httpx.AsyncClient, files: Path, mesh: dict[str, Any]) -> None:
    ballast = fill(files)
    _expect(await _upload(http, 1), 507, "storage-full")
    _expect(await http.get(mesh["links"]["file"], params={"format": "msh"}), 507, "storage-full")
    _expect(await http.get(mesh["links"]["file"], params={"format": "xdmf"}), 507, "storage-full")
    for wait in (0, 30):
        assert (await _mesh(http, wait))["status"] == "succeeded"  # small files are rows of the database
        failed = await _mesh(http, wait, grid={"n_xi": 200, "n_eta": 200})
        assert (failed["status"], failed["error"]["type"]) == ("failed", "/problems/storage-full"), failed
    assert (await http.get(mesh["links"]["quality"])).status_code == 200  # what is there is served
    ballast.unlink()
    assert not list((files / "unfinished").iterdir())
    for format in ("msh", "xdmf"):
        assert (await http.get(mesh["links"]["file"], params={"format": format})).status_code == 200
    assert (await _mesh(http))["status"] == "succeeded"
    assert (await _upload(http, 1)).status_code == 201


async def _files_without_writes(http: httpx.AsyncClient, files: Path, mesh: dict[str, Any]) -> None:
    await read_only(files, True)
    answer = await _upload(http, 2)
    _expect(answer, 503, "unavailable")
    assert answer.headers["retry-after"]
    _expect(await http.get(mesh["links"]["file"], params={"format": "vtk"}), 503, "unavailable")
    await _not_ready(http, "files")
    await read_only(files, False)
    await _ready(http)
    assert (await _upload(http, 2)).status_code == 201


async def _not_ready(http: httpx.AsyncClient, name: str) -> None:
    await asyncio.sleep(1.1)  # an answer is given again for a second
    answer = await http.get("/readyz")
    assert (answer.status_code, "cannot be used" in answer.json()["checks"][name]) == (503, True), answer.text


async def _ready(http: httpx.AsyncClient) -> None:
    await asyncio.sleep(1.1)
    assert (await http.get("/readyz")).status_code == 200


async def _full_database(http: httpx.AsyncClient, data: Path) -> None:
    ballast = fill(data)
    for _ in range(300):  # what the log of the database has room for still fits
        answer = await http.post("/v1/meshes", json=small(label="x" * 200))
        if answer.status_code != 202:
            break
    _expect(answer, 507, "storage-full")
    ballast.unlink()
    assert (await http.post("/v1/meshes", json=small(label="room"))).status_code == 202
    database = sqlite3.connect(data / "equimesh.sqlite3")
    try:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    finally:
        database.close()
    page = (await http.get("/v1/meshes", params={"limit": 200})).json()
    for item in page["items"]:
        if item["label"] is not None:
            assert (await http.delete(item["links"]["self"])).status_code == 204


async def _database_without_writes(http: httpx.AsyncClient, data: Path, service: Any, mesh: dict[str, Any]) -> None:
    # A disk with open files cannot be made so: everything that holds the database lets go of it first.
    service.lock.close()
    service.engine.close()
    service.side_workers.close()
    deadline = time.monotonic() + 300.0
    while time.monotonic() < deadline:
        service.store.close()
        # With the log that a killed process leaves, the database can be opened for reading on such a disk.
        subprocess.run([sys.executable, "-c", _LEAVE_LOG, data / "equimesh.sqlite3"], check=True)
        if subprocess.run(["mount", "-o", "remount,ro", data], capture_output=True).returncode == 0:
            break
        await asyncio.sleep(0.01)
    else:
        raise AssertionError("the database stays open")
    _expect(await http.post("/v1/meshes", json=small()), 503, "unavailable")
    _expect(await http.delete(mesh["links"]["self"]), 503, "unavailable")
    await _not_ready(http, "store")
    assert (await http.get(mesh["links"]["self"])).status_code == 200
    with service.store.database.read() as reading:  # a reader from before the disk is back
        reading.execute(text("SELECT * FROM meshes")).first()
        await read_only(data, False)
        posted = asyncio.create_task(http.post("/v1/meshes", json=small()))
        await asyncio.sleep(0.5)
    assert (await posted).status_code == 202
    assert (await http.get(mesh["links"]["quality"])).status_code == 200
    assert (await http.delete(mesh["links"]["self"])).status_code == 204
