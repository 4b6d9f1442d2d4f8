"""Files in a folder and in S3: the port, HTTP over it, memory, and addresses that cannot be used."""

from __future__ import annotations

import asyncio
import hashlib
import itertools
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from pydantic import SecretStr
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from equimesh_service import Settings, running
from equimesh_service.files.address import FilesAddress, files_address
from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files, FilesError, StoredFile
from equimesh_service.files.s3 import Bucket, S3Files
from equimesh_service.files.unfinished import clear
from equimesh_service.problems.problem import Problem
from equimesh_service.wire.sending import send_file
from service.conftest import small, until
from service.files.check_files import CHECKS, keep, read
from service.s3_server import ACCESS_KEY, SECRET_KEY, S3Server, serving

CONTENT = bytes(range(256)) * 40
_numbers = itertools.count()


@pytest.fixture(scope="session")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    """A server of the S3 protocol."""
    with serving(tmp_path_factory.mktemp("s3")) as server:
        yield server


def bucket_of(s3: S3Server, name: str, **more: Any) -> Bucket:
    """How a bucket of the server is reached."""
    keys = {"access_key": SecretStr(ACCESS_KEY), "secret_key": SecretStr(SECRET_KEY)}
    return Bucket(**{"name": name, "prefix": "a/b", "endpoint": s3.endpoint, **keys, **more})


@pytest.fixture(params=["folder", "s3"])
def files(request: pytest.FixtureRequest, tmp_path: Path) -> Files:
    """Files of both kinds, prepared; their temporary files are in ``tmp_path``."""
    if request.param == "folder":
        found: Files = FolderFiles(tmp_path)
    else:
        server: S3Server = request.getfixturevalue("s3")
        name = f"bucket-{next(_numbers)}"
        server.bucket(name)
        found = S3Files(bucket_of(server, name), tmp_path)
    found.prepare(alone=True)
    return found


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_an_implementation_of_files(check: Callable[[Files, Path], None], files: Files, tmp_path: Path) -> None:
    check(files, tmp_path)


def answered(files: Files, file: StoredFile, *requests: dict[str, str], method: str = "GET") -> list[httpx.Response]:
    """What requests with these headers for a file get."""

    async def route(request: Request) -> Response:
        try:
            return await send_file(request, files, file, "model/mesh", filename="mesh.bin")
        except Problem as problem:
            return problem.response()

    async def ask() -> list[httpx.Response]:
        transport = httpx.ASGITransport(Starlette(routes=[Route("/", route)]))
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return [await client.request(method, "/", headers=headers) for headers in requests]

    return asyncio.run(ask())


def test_a_file_over_http(files: Files) -> None:
    file = keep(files, CONTENT)
    etag = f'"{file.sha256}"'
    [whole] = answered(files, file, {})
    assert (whole.status_code, whole.content, whole.headers["etag"]) == (200, CONTENT, etag)
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    assert {name: whole.headers[name] for name in ("content-length", "content-type", "accept-ranges")} == {
        "content-length": str(len(CONTENT)),
        "content-type": "model/mesh",
        "accept-ranges": "bytes",
    }
    assert whole.headers["content-disposition"] == 'attachment; filename="mesh.bin"'
    [head] = answered(files, file, {"Range": "bytes=1-2"}, method="HEAD")
    assert (head.status_code, head.content, head.headers["content-length"]) == (200, b"", str(len(CONTENT)))
    for same in answered(
        files, file, *({"If-None-Match": named} for named in (etag, f'"other", W/{etag}', "*", f'{etag},"x"'))
    ):
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", etag)
    for other in answered(files, file, {"If-None-Match": '"other"'}, {"If-Match": f'"x", {etag}'}, {"If-Match": "*"}):
        assert other.status_code == 200
    for failed in answered(files, file, {"If-Match": '"other"'}, {"If-Match": f"W/{etag}", "Range": "bytes=0-1"}):
        assert (failed.status_code, failed.json()["type"]) == (412, "/problems/precondition-failed")
        assert failed.headers["etag"] == etag
    files.remove(file.sha256)
    [gone] = answered(files, file, {})
    assert (gone.status_code, gone.json()["type"]) == (404, "/problems/not-found")


@pytest.mark.parametrize(
    ("header", "start", "end"),
    [("bytes=10-19", 10, 20), ("bytes=10000-", 10000, 10240), ("bytes=-3", 10237, 10240), ("bytes=0-99999", 0, 10240)],
)
def test_a_part_of_a_file(files: Files, header: str, start: int, end: int) -> None:
    file = keep(files, CONTENT)
    etag = f'"{file.sha256}"'
    for part in answered(files, file, {"Range": header}, {"Range": header, "If-Range": etag}):
        assert (part.status_code, part.content) == (206, CONTENT[start:end])
        assert part.headers["content-range"] == f"bytes {start}-{end - 1}/{len(CONTENT)}"
        assert (part.headers["content-length"], part.headers["etag"]) == (str(end - start), etag)
    for named in ('"other"', f"W/{etag}", "Sat, 21 Nov 2026 00:00:00 GMT"):
        [whole] = answered(files, file, {"Range": header, "If-Range": named})
        assert (whole.status_code, whole.content) == (200, CONTENT)


def test_several_parts_of_a_file(files: Files) -> None:
    file = keep(files, CONTENT)
    several, last = answered(files, file, {"Range": "bytes=0-4, 99999-, -2 ,20-29"}, {"Range": "bytes=99999-,5-6"})
    assert several.status_code == 206
    found = re.fullmatch(r"multipart/byteranges; boundary=(\w+)", several.headers["content-type"])
    assert found is not None
    before, *parts, after = several.content.split(f"--{found[1]}".encode())
    assert (before, after, len(several.content)) == (b"\r\n", b"--\r\n", int(several.headers["content-length"]))
    expected = [(0, 5), (10238, 10240), (20, 30)]
    for part, (start, end) in zip(parts, expected, strict=True):
        head, _, body = part.partition(b"\r\n\r\n")
        assert body == CONTENT[start:end] + b"\r\n"
        assert head.decode() == f"\r\nContent-Type: model/mesh\r\nContent-Range: bytes {start}-{end - 1}/{len(CONTENT)}"
    assert (last.status_code, last.content) == (206, CONTENT[5:7])


def test_ranges_that_get_the_whole_file_or_a_problem(tmp_path: Path) -> None:
    files = FolderFiles(tmp_path)
    files.prepare(alone=True)
    file = keep(files, CONTENT)
    many = "bytes=" + ",".join(f"{2 * k}-{2 * k}" for k in range(17))
    ignored = ("bytes=5-2", "bytes=x", "items=0-1", "bytes=--5", "bytes=0-9,5-12", "bytes=0-,0-,0-", many)
    for answer in answered(files, file, *({"Range": header} for header in ignored)):
        assert (answer.status_code, answer.content) == (200, CONTENT)
    past = ("bytes=10240-", "bytes=-0", f"bytes={'9' * 5000}-")
    for answer in answered(files, file, *({"Range": header} for header in past)):
        assert (answer.status_code, answer.headers["content-range"]) == (416, f"bytes */{len(CONTENT)}")
        assert answer.json()["type"] == "/problems/range-not-satisfiable"


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is read as Linux tells it")
def test_memory_does_not_grow_with_the_file(files: Files, s3: S3Server) -> None:
    size = 200_000_000
    with files.unfinished(".bin") as path:
        os.truncate(path, size)  # zeros, which take no room
        file = StoredFile("0" * 64, size)
        if isinstance(files, S3Files):
            shelf = s3.folder / files.bucket.name / files.bucket.prefix / "00"
            shelf.mkdir(parents=True)
            path.rename(shelf / file.sha256)
        else:
            files.publish(path, file, lambda _: False)
    sent = 0

    async def send(message: dict[str, Any]) -> None:
        nonlocal sent
        sent += len(message.get("body", b""))

    async def receive() -> dict[str, Any]:
        await asyncio.sleep(60.0)
        raise AssertionError

    async def download(until: int) -> None:
        scope = {"type": "http", "method": "GET", "headers": [(b"range", f"bytes=0-{until - 1}".encode())]}
        response = await send_file(Request(scope), files, file, "model/mesh")
        await response(scope, receive, send)  # type: ignore[arg-type]

    asyncio.run(download(4_000_000))  # what is loaded and started once
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts at what is held now
    before = _peak()
    asyncio.run(download(size))
    assert sent == 4_000_000 + size
    assert _peak() - before < 16_000_000


def _peak() -> int:
    """Most bytes of memory that this process held since its peak was cleared."""
    text = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+) kB", text)[1]) * 1024  # type: ignore[index]


def test_publishing_in_s3_asks_nothing_unless_the_content_was_removed(tmp_path: Path) -> None:
    nobody = Bucket(name="nowhere", endpoint="http://127.0.0.1:9", access_key=SecretStr("a"), secret_key=SecretStr("b"))
    files, file = S3Files(nobody, tmp_path), StoredFile("0" * 64, 1)
    files.publish(tmp_path, file, lambda _: False)
    with pytest.raises(FilesError, match="does not answer"):
        files.publish(tmp_path, file, lambda sha256: sha256 == file.sha256)


def test_a_damaged_object_is_not_taken_for_a_mesh(s3: S3Server, tmp_path: Path) -> None:
    folder = s3.bucket("damaged")
    files = S3Files(bucket_of(s3, "damaged", prefix=""), tmp_path)
    files.prepare(alone=True)
    file = keep(files, b"right")
    (folder / file.sha256[:2] / file.sha256).write_bytes(b"wrong")
    with pytest.raises(FilesError, match="is damaged"):
        read(files, file.sha256)


def test_an_address_of_files(tmp_path: Path) -> None:
    def opened(url: str, **more: Any) -> Files:
        return FilesAddress(folder=tmp_path, url=url, **more).open()

    assert opened("") == FolderFiles(tmp_path)
    assert opened("file:///a%20b/c") == FolderFiles(Path("/a b/c"))
    assert opened("s3://bucket/a/b/") == S3Files(Bucket(name="bucket", prefix="a/b"), tmp_path)
    settings = Settings(data_dir=tmp_path, files_url="s3://bucket", s3_endpoint="http://x:1/", s3_region="eu")
    assert files_address(settings).open() == S3Files(
        Bucket(name="bucket", endpoint="http://x:1", region="eu"), tmp_path / "files"
    )
    for url, more, match in (
        ("ftp://x/y", {}, "it must be s3://bucket/prefix"),
        ("file://host/x", {}, "it must be"),
        ("s3:bucket", {}, "no name of a bucket"),
        ("s3://hidden:hidden@bucket/x", {}, r"'s3://…@bucket/x'"),
        ("s3://bucket", {"endpoint": "s3.example.org"}, "S3_ENDPOINT must be an address"),
        ("s3://bucket", {"access_key": SecretStr("hidden")}, "go together"),
    ):
        with pytest.raises(FilesError, match=match) as caught:
            opened(url, **more)
        assert "hidden" not in str(caught.value)


def test_s3_needs_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(FilesError, match=r"pip install 'equimesh\[s3\]'"):
        FilesAddress(folder=tmp_path, url="s3://bucket").open()


@pytest.mark.parametrize(
    ("more", "match"),
    [
        ({"name": "nowhere"}, "there is no bucket s3://nowhere/a/b at http"),
        ({"secret_key": SecretStr("wrong")}, "does not take the key: see EQUIMESH_S3_ACCESS_KEY"),
        ({"access_key": SecretStr("wrong")}, "does not take the key"),
        ({"endpoint": "http://127.0.0.1:9"}, "does not answer as S3 storage does"),
    ],
)
def test_a_storage_that_cannot_be_used(s3: S3Server, tmp_path: Path, more: dict[str, Any], match: str) -> None:
    (s3.folder / "usable").mkdir(exist_ok=True)
    files = S3Files(bucket_of(s3, **{"name": "usable", **more}), tmp_path)
    with pytest.raises(FilesError, match=match) as caught:
        files.prepare(alone=True)
    assert SECRET_KEY not in str(caught.value)
    assert "wrong" not in str(caught.value)


def test_a_service_that_keeps_its_files_in_s3(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    with serving(tmp_path_factory.mktemp("s3")) as s3:
        bucket = s3.bucket("meshes")
        settings = Settings(
            data_dir=tmp_path,
            port=0,
            workers=1,
            log_level="error",
            files_url="s3://meshes/all",
            s3_endpoint=s3.endpoint,
            s3_access_key=SecretStr(ACCESS_KEY),
            s3_secret_key=SecretStr(SECRET_KEY),
            reuse=False,
        )
        with running(settings) as url, httpx.Client(base_url=url, timeout=60.0) as http:
            _use(http, s3, bucket)


def _use(http: httpx.Client, s3: S3Server, bucket: Path) -> None:
    def objects() -> set[str]:
        return {path.name for path in bucket.rglob("*") if path.is_file()}

    x = [k / 16 for k in range(17)]
    samples = http.post("/v1/samples", json={"grid": {"x": x, "y": x, "values": [[a * b for b in x] for a in x]}})
    assert samples.status_code == 201, samples.text
    name = samples.json()["id"]
    assert http.get(f"/v1/samples/{name}?format=npz").status_code == 200
    spec = {"monitor": {"kind": "curvature", "u": {"samples": name}}, "grid": {"n_xi": 8, "n_eta": 8}}
    mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=30"}).json()
    assert mesh["status"] == "succeeded", mesh["error"]
    whole = http.get(mesh["links"]["file"])
    etag = whole.headers["etag"]
    assert etag == f'"{hashlib.sha256(whole.content).hexdigest()}"'
    first = http.get(mesh["links"]["file"], headers={"Range": "bytes=0-99"})
    rest = http.get(mesh["links"]["file"], headers={"Range": "bytes=100-", "If-Range": etag})
    assert (first.status_code, rest.status_code) == (206, 206)
    assert first.content + rest.content == whole.content
    assert http.get(mesh["links"]["file"], headers={"If-None-Match": etag}).status_code == 304
    assert etag.strip('"') in objects()
    before = objects()
    other = http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=30"}).json()
    unnamed = objects() - before

    s3.kill()
    before = objects()
    asked = http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=30"})
    assert (asked.status_code, asked.json()["status"]) == (201, "failed")  # three attempts, none of them half there
    assert "could not be reached" in asked.json()["error"]["detail"]
    for down in (
        http.get(mesh["links"]["file"]),
        http.get(mesh["links"]["file"], params={"format": "msh"}),
        http.post("/v1/samples", content=b"x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,3\n", headers={"Content-Type": "text/csv"}),
    ):
        assert (down.status_code, down.json()["type"]) == (503, "/problems/unavailable"), down.text
        assert down.headers["retry-after"]
    assert http.delete(other["links"]["self"]).status_code == 204  # the sweep removes its files
    ready = http.get("/readyz")
    assert (ready.status_code, ready.json()["checks"]["store"]) == (503, "ok")
    assert "cannot be used" in ready.json()["checks"]["files"]
    s3.start()
    assert objects() == before

    until(lambda: http.get("/readyz").status_code == 200)
    assert http.get(mesh["links"]["file"]).content == whole.content
    assert http.get(mesh["links"]["file"], params={"format": "msh"}).status_code == 200
    assert http.delete(mesh["links"]["self"]).status_code == 204
    assert http.delete(asked.json()["links"]["self"]).status_code == 204
    assert http.delete(f"/v1/samples/{name}").status_code == 204
    assert objects() == unnamed


def test_a_start_clears_the_folders_of_killed_writers_too(tmp_path: Path) -> None:
    folder = tmp_path / "unfinished"
    (folder / ".equimesh-abc").mkdir(parents=True)
    (folder / ".equimesh-abc" / "mesh.vtu").write_text("half")
    (folder / "x.npz").write_text("half")
    clear(folder, alone=False)  # of another service, perhaps, that is at work
    assert len([*folder.iterdir()]) == 2
    clear(folder, alone=True)
    assert [*folder.iterdir()] == []
