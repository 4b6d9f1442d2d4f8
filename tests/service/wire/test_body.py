"""Bodies of requests as they are read, and of answers as they are sent."""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import sys
import tracemalloc
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from equimesh_service.files.folder import FolderFiles
from equimesh_service.files.port import Files, StoredFile
from equimesh_service.files.s3 import S3Files
from equimesh_service.problems.problem import Problem
from equimesh_service.wire import body as bodies
from equimesh_service.wire.body import MEMORY_BYTES, BodyPlace, BodyRoom, is_quick, parts_of, read_body
from equimesh_service.wire.sending import Span, parse_ranges, send_file
from service.files.check_files import keep
from service.s3_server import S3Server
from service.storages import CONTENT

MALFORMED: dict[str, bytes] = {
    "nothing": b"",
    "half an object": b'{"monitor": ',
    "not UTF-8": b'{"label": "\xff"}',
    "UTF-16": '{"monitor": 1}'.encode("utf-16"),
    "twice a key": b'{"monitor": {"kind": "arc_length", "u": {"expression": "x"}}, "grid": {"n_xi": 8, "n_xi": 9}}',
    "deep lists": b"[" * 200_000,
    "deep objects": b'{"a":' * 100_000,
    "text": b"hello",
    "a comment": b"{} // no",
}


@pytest.mark.parametrize("name", MALFORMED)
def test_what_is_not_json_is_a_400(http: httpx.Client, name: str) -> None:
    answer = http.post("/v1/meshes", content=MALFORMED[name], headers={"Content-Type": "application/json"})
    assert answer.status_code == 400, answer.text
    assert answer.json()["type"] == "/problems/malformed-body"


def test_the_type_of_the_body_counts(http: httpx.Client) -> None:
    for headers in (
        {"Content-Type": "text/plain"},
        {},
        {"Content-Type": "application/json", "Content-Encoding": "gzip"},
    ):
        answer = http.post("/v1/meshes", content=b"{}", headers=headers)
        assert answer.status_code == 415
        assert answer.json()["type"] == "/problems/unsupported-media-type"


def test_large_bodies_are_refused_before_they_are_read(http: httpx.Client) -> None:
    headers = {"Content-Type": "application/json"}
    announced = http.post("/v1/meshes", content=b" " * 2_000_001, headers=headers)
    streamed = http.post("/v1/meshes", content=(b" " * 100_000 for _ in range(30)), headers=headers)
    for answer in (announced, streamed):
        assert answer.status_code == 413
        assert answer.json()["type"] == "/problems/body-too-large"


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="other"\r\n\r\n{}\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="samples"; filename="a.npz"\r\n\r\n{}\r\n--b--\r\n',
        b"--b\r\nContent-Disposition: form-data\r\n\r\n{}\r\n--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}',
        (b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n{}\r\n' * 2) + b"--b--\r\n",
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n\xff\xfe\r\n--b--\r\n',
        b'--b\r\nContent-Disposition: form-data; name="spec"\r\n\r\n' + b"\r\n" * 50_000 + b"--b--\r\n",
    ],
)
def test_broken_multipart_is_a_400(http: httpx.Client, body: bytes) -> None:
    headers = {"Content-Type": "multipart/form-data; boundary=b"}
    answer = http.post("/v1/meshes", content=body, headers=headers)
    assert answer.status_code == 400, answer.text
    assert http.post("/v1/meshes", content=body, headers={"Content-Type": "multipart/form-data"}).status_code == 400


FORM = "multipart/form-data; boundary=b"
_SPEC = b'--b\r\nContent-Disposition: form-data; name="spec"'
_FILE = b'--b\r\nContent-Disposition: form-data; name="samples"; filename="a.npz"'
ALLOWED = ("spec", "samples", "mesh")


@pytest.mark.parametrize(
    ("body", "is_plain"),
    [
        (
            _SPEC + b"\r\n\r\n{}\r\n" + _FILE + b"\r\nContent-Type: Application/X-Npz\r\n\r\n\r\n--b\0\r\n--b--\r\n",
            False,
        ),
        (_SPEC + b"\r\nContent-Type: application/json\r\n\r\n{}\r\n" + _FILE + b"\r\n\r\n\r\n\0--b\r\n--b--", True),
        (_FILE + b"\r\nContent-Type: Application/X-Npz\r\n\r\n\r\n--b--\r\n", True),
        (_SPEC + "\r\n\r\n{é}\r\n--b--\r\n".encode(), True),
        (_SPEC + b"\r\n\r\n\xff\r\n--b--\r\n", False),
        (_SPEC.lower() + b"\r\n\r\n{}\r\n--b--\r\n", False),
        (_SPEC + b"\r\n\r\n{}\r\n--b--\r\nand more", False),
        (_SPEC + b'; filename="a b.npz"\r\n\r\n{}\r\n--b--\r\n', False),
        (b"before\r\n" + _SPEC + b"\r\n\r\n{}\r\n--b--\r\n", False),
        ((_SPEC + b"\r\n\r\n{}\r\n") * 2 + b"--b--\r\n", True),
        ((_SPEC + b"\r\n\r\n{}\r\n") * 9 + b"--b--\r\n", False),
    ],
)
def test_a_plain_form_has_the_parts_that_the_parser_finds(
    body: bytes, is_plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found() -> object:
        try:
            return parts_of(FORM, body, ALLOWED)
        except Problem as problem:
            return problem.detail

    before = found()
    assert (bodies._plain_parts(FORM, body) is not None) == is_plain
    monkeypatch.setattr(bodies, "_plain_parts", lambda *_: None)
    assert found() == before


def request_of(receive: Callable[[], Awaitable[dict[str, Any]]]) -> Request:
    return Request({"type": "http", "method": "POST", "path": "/", "headers": []}, receive)


PIECE = bytes(range(256)) * 256


def test_a_long_body_comes_as_it_was_sent(tmp_path: Path) -> None:
    pieces = [PIECE[k:] for k in range(100)]

    async def receive() -> dict[str, Any]:
        return {
            "type": "http.request",
            "body": pieces[len(taken)],
            "more_body": not taken.append(1) and len(taken) < 100,
        }

    taken: list[int] = []
    place = BodyRoom(tmp_path, 10**8).place("")
    with place as found:
        assert asyncio.run(read_body(request_of(receive), 10**8, found)) == b"".join(pieces)
    assert not list(tmp_path.iterdir())


def test_bodies_that_never_end_take_little_memory(tmp_path: Path) -> None:
    """20 bodies of 10 MB without an end: as many bytes in memory as MEMORY_BYTES allows."""

    async def unfinished(came: list[int]) -> dict[str, Any]:
        if len(came) == 160:
            await asyncio.Event().wait()
        came.append(len(PIECE))
        return {"type": "http.request", "body": bytes(PIECE), "more_body": True}

    async def send_all() -> int:
        arrived: list[list[int]] = [[] for _ in range(20)]
        place = BodyPlace(BodyRoom(tmp_path, 10**8), "")
        tasks = [
            asyncio.create_task(read_body(request_of(partial(unfinished, came)), 10**8, place)) for came in arrived
        ]
        while not all(len(came) == 160 for came in arrived):
            await asyncio.sleep(0.01)
        held = tracemalloc.get_traced_memory()[0]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        return held

    tracemalloc.start()
    try:
        held = asyncio.run(send_all())
    finally:
        tracemalloc.stop()
    assert held < 20 * 1.5 * MEMORY_BYTES


def test_a_key_has_room_for_some_bodies_and_the_others_keep_theirs(tmp_path: Path) -> None:
    room = BodyRoom(tmp_path, 100)
    with ExitStack() as stack:
        first = stack.enter_context(room.place("a"))
        first.reserve(700)
        first.reserve(100)  # a body of which less is there than was announced
        with room.place("a") as place:
            place.reserve(100)
            with pytest.raises(Problem, match="This key has 800 bytes of bodies under way") as caught:
                place.reserve(101)
            assert (caught.value.kind.status, caught.value.headers["Retry-After"]) == (429, "5")
        with room.place("a") as place:
            place.reserve(100)  # of a request that is answered nothing is left
        for key in "bcd":
            stack.enter_context(room.place(key)).reserve(800)
        with room.place("") as place, pytest.raises(Problem, match="Too many bytes of bodies") as caught:
            place.reserve(101)
        assert caught.value.kind.status == 503


def test_a_body_without_room_is_refused_by_its_length_before_it_is_sent(tmp_path: Path) -> None:
    async def receive() -> dict[str, Any]:
        raise AssertionError("nothing is read")

    request = request_of(receive)
    request.scope["headers"] = [(b"content-length", b"99")]
    room = BodyRoom(tmp_path, 100)
    with room.place("a") as all_of_it, room.place("a") as place:
        all_of_it.reserve(750)
        with pytest.raises(Problem, match="bytes of bodies under way"):
            asyncio.run(read_body(request, 100, place))


def test_only_what_takes_milliseconds_is_taken_apart_on_the_event_loop() -> None:
    lines = b"\r\n" * 40_000
    assert is_quick("application/json; charset=utf-8", lines)  # its text is read elsewhere
    assert is_quick("multipart/form-data; boundary=x", lines[:60_000])
    assert not is_quick("multipart/form-data; boundary=x", lines)
    assert not is_quick("application/x-npz", b"no zip")


def answered(files: Files, file: StoredFile, *requests: dict[str, str], method: str = "GET") -> list[httpx.Response]:
    """The answers to requests for a file with these headers."""

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
    """The peak of the memory of this process in bytes, since it was cleared."""
    text = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s*(\d+) kB", text)[1]) * 1024  # type: ignore[index]


# Ranges of a file over HTTP.


@pytest.mark.parametrize("header", ["bytes=5-2", "bytes=abc", "bytes=", "items=0-1", "bytes=--5", "bytes=1-,x"])
def test_a_range_that_is_none_is_ignored(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    assert (answer.status_code, answer.content) == (200, http.get(url).content)


@pytest.mark.parametrize("header", ["bytes=99999999-", "bytes=-0", f"bytes={'9' * 6000}-", "bytes=99999998-,-0"])
def test_a_range_past_the_end_is_a_problem(http: httpx.Client, finished: dict[str, Any], header: str) -> None:
    url = finished["links"]["file"]
    answer = http.get(url, headers={"Range": header})
    size = len(http.get(url).content)
    assert (answer.status_code, answer.headers["content-range"]) == (416, f"bytes */{size}")
    assert answer.headers["content-type"] == "application/problem+json"
    assert (answer.json()["type"], answer.json()["detail"]) == (
        "/problems/range-not-satisfiable",
        f"The file has {size} bytes.",
    )
    assert http.get(url, headers={"Range": f"{header},0-1"}).content == http.get(url).content[:2]


@pytest.mark.parametrize(
    ("header", "spans"),
    [
        (None, ()),
        ("bytes=0-0", (Span(0, 1),)),
        ("BYTES= 2-3 , -1", (Span(2, 4), Span(9, 10))),
        ("bytes=-99", (Span(0, 10),)),
        ("bytes=5-,0-1", (Span(5, 10), Span(0, 2))),
        ("bytes=0-1,10-", (Span(0, 2),)),  # what is past the end does not count while another part is there
        ("bytes=0-4,4-5", ()),  # one byte twice
        ("bytes=" + ",".join(f"{k}-{k}" for k in range(9)), tuple(Span(k, k + 1) for k in range(9))),
        ("bytes=3-2,0-1", ()),
    ],
)
def test_a_header_is_read_as_parts_of_ten_bytes(header: str | None, spans: tuple[Span, ...]) -> None:
    assert parse_ranges(header, 10) == spans


def test_an_empty_file_has_no_part() -> None:
    with pytest.raises(Problem) as caught:
        parse_ranges("bytes=0-", 0)
    assert (caught.value.name, caught.value.headers) == ("range-not-satisfiable", {"Content-Range": "bytes */0"})
    assert Span(3, 7).content_range(10) == "bytes 3-6/10"
