"""Bodies that are refused: not JSON, too large, of a wrong type, or broken multipart."""

from __future__ import annotations

import asyncio
import tracemalloc
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.requests import Request

from equimesh_service.problems.problem import Problem
from equimesh_service.wire.body import MEMORY_BYTES, BodyPlace, BodyRoom, is_quick, read_body

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
