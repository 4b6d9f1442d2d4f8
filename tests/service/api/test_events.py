"""Streams of events that continue from any number, after cut connections and a restart: no gap, no event twice."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import pytest

from equimesh_service import Settings, running
from service.conftest import SLOW, until
from service.requests import post


def raw(url: str, path: str, last: str | None = None, most: int | None = None, seconds: float = 30.0) -> bytes:
    """The answer to one request, to its last byte or to the byte after which the connection is cut."""
    place = urlsplit(url)
    resume = "" if last is None else f"Last-Event-ID: {last}\r\n"
    head = (
        f"GET {path} HTTP/1.1\r\nHost: {place.netloc}\r\nAccept: text/event-stream\r\n{resume}Connection: close\r\n\r\n"
    )
    found = b""
    with socket.create_connection((str(place.hostname), int(place.port or 80)), timeout=seconds) as wire:
        wire.sendall(head.encode())
        while most is None or len(found) < most:
            piece = wire.recv(4096 if most is None else min(4096, most - len(found)))
            if not piece:
                break
            found += piece
    return found


def events(answer: bytes) -> list[tuple[int, str, Any]]:
    """The complete events in the bytes of an answer, of which only a part may have arrived."""
    head, _, rest = answer.partition(b"\r\n\r\n")
    if b"chunked" not in head.lower():
        return []
    body = b""
    while b"\r\n" in rest:
        size, _, rest = rest.partition(b"\r\n")
        body, rest = body + rest[: int(size, 16)], rest[int(size, 16) + 2 :]
    *blocks, _ = body.decode("utf-8", errors="ignore").split("\n\n")
    fields = [dict(line.split(": ", 1) for line in block.splitlines() if ": " in line) for block in blocks]
    return [(int(one["id"]), one["event"], json.loads(one["data"])) for one in fields if "id" in one]


def whole(http: httpx.Client, mesh_id: str) -> list[tuple[int, str, Any]]:
    """All events of a mesh, read as JSON."""
    told = http.get(f"/v1/meshes/{mesh_id}/events", headers={"Accept": "application/json"}).json()
    assert told["done"]
    return [(one["id"], one["event"], one["data"]) for one in told["items"]]


def test_from_any_number_come_all_later_ones(url: str, http: httpx.Client, finished: dict[str, Any]) -> None:
    path = finished["links"]["events"]
    every = whole(http, finished["id"])
    assert [number for number, _, _ in every] == list(range(1, len(every) + 1))
    for last in sorted({0, 1, len(every) // 2, len(every) - 1}):
        assert events(raw(url, path, str(last))) == every[last:]
        assert events(raw(url, f"{path}?after={last}")) == every[last:]
    assert events(raw(url, f"{path}?after=2", "1")) == every[2:]  # the larger of the two


@pytest.mark.parametrize("last", ["end", "1000", "9" * 18, "9" * 40])
def test_past_the_end_there_is_nothing_more(url: str, http: httpx.Client, finished: dict[str, Any], last: str) -> None:
    number = str(len(whole(http, finished["id"]))) if last == "end" else last
    answer = raw(url, finished["links"]["events"], number)
    assert answer.startswith(b"HTTP/1.1 204 ")
    assert answer.endswith(b"\r\n\r\n")


@pytest.mark.parametrize("last", ["", "x", "-1", "1.5", "1e3", "0x2", " ", "1, 2", "\u0662", "NaN"])
def test_what_is_no_number_is_from_the_beginning(
    url: str, http: httpx.Client, finished: dict[str, Any], last: str
) -> None:
    assert events(raw(url, finished["links"]["events"], last)) == whole(http, finished["id"])


@pytest.mark.parametrize("after", ["-1", "x", "1e3", "9" * 30])
def test_a_parameter_that_is_no_number_is_refused(http: httpx.Client, finished: dict[str, Any], after: str) -> None:
    answer = http.get(finished["links"]["events"], params={"after": after})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == "after"


def test_a_cut_at_any_byte_loses_nothing(url: str, http: httpx.Client, finished: dict[str, Any]) -> None:
    path, every = finished["links"]["events"], whole(http, finished["id"])
    length = len(raw(url, path))
    for cut in np.random.default_rng(11).integers(1, length, 12):
        got = events(raw(url, path, most=int(cut)))
        assert got == every[: len(got)]
        rest = raw(url, path, str(len(got)) if got else None)
        assert got + events(rest) == every


def test_a_number_that_never_was_does_not_hold_the_stream_open(url: str, http: httpx.Client) -> None:
    mesh = http.post("/v1/meshes", json=SLOW).json()
    until(lambda: http.get(f"/v1/meshes/{mesh['id']}").json()["status"] == "running")
    with httpx.stream("GET", f"{url}{mesh['links']['events']}?after=99999", timeout=600.0) as stream:
        http.post(f"/v1/meshes/{mesh['id']}/cancel")
        assert "event: done" in stream.read().decode()
    assert http.delete(f"/v1/meshes/{mesh['id']}").status_code == 204
    assert raw(url, mesh["links"]["events"], "3").startswith(b"HTTP/1.1 404 ")


@pytest.mark.everything  # two starts of a service
def test_a_restart_of_the_service_in_between(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, port=0, workers=1, log_level="warning", lease=2)
    with running(settings) as url, httpx.Client(base_url=url) as http:
        mesh = http.post("/v1/meshes", json=SLOW).json()
        path = mesh["links"]["events"]
        first = events(raw(url, path, most=4000))
        assert len(first) > 3
    with running(settings) as url, httpx.Client(base_url=url) as http:
        second = events(raw(url, path, str(len(first)), most=4000))
        until(lambda: http.get(f"/v1/meshes/{mesh['id']}").json()["status"] == "running")
        assert http.post(f"/v1/meshes/{mesh['id']}/cancel").status_code == 200
        last = events(raw(url, path, str(len(first) + len(second))))
        assert first + second + last == whole(http, mesh["id"])
        assert last[-1][1] == "done"
        assert len(second) > 3


def test_events_stream_to_the_end(http: httpx.Client) -> None:
    settings = {**SLOW["schwarz"], "max_iterations": 30}  # some tenths of a second
    mesh = post(http, {**SLOW, "grid": {"n_xi": 20, "n_eta": 20}, "schwarz": settings}).json()
    with http.stream("GET", mesh["links"]["events"]) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        blocks = "".join(stream.iter_text()).strip().split("\n\n")
    events = [dict(line.split(": ", 1) for line in block.splitlines()) for block in blocks[1:] if "id: " in block]
    assert blocks[0].startswith("retry:")
    assert [int(event["id"]) for event in events] == list(range(1, len(events) + 1))
    kinds = [event["event"] for event in events]
    assert kinds[0] == "status"
    assert "progress" in kinds
    assert kinds[-1] == "done"
    told = [json.loads(event["data"]) for event in events if event["event"] == "progress"]
    assert all(progress["phase"] for progress in told)
    fractions = [progress["fraction"] for progress in told if progress["fraction"] is not None]
    assert fractions == sorted(fractions)
    assert json.loads(events[-1]["data"]) == {"status": "succeeded"}
    with http.stream("GET", mesh["links"]["events"], headers={"Last-Event-ID": "2"}) as stream:
        assert "id: 3\n" in (rest := "".join(stream.iter_text()))
        assert "id: 2\n" not in rest
    rows = http.get(mesh["links"]["events"], params={"after": 2}, headers={"Accept": "application/json"}).json()
    assert [row["id"] for row in rows["items"]] == list(range(3, len(events) + 1))
    assert rows["done"]
    over = http.get(mesh["links"]["events"], headers={"Last-Event-ID": str(len(events))})
    assert over.status_code == 204


def test_events_come_while_the_mesh_is_computed(http: httpx.Client) -> None:
    mesh = post(http, SLOW).json()
    try:
        with http.stream("GET", mesh["links"]["events"]) as stream:
            lines = stream.iter_lines()
            assert any(line == "event: progress" for line in lines)
            assert http.get(mesh["links"]["self"]).json()["status"] == "running"
            http.post(mesh["links"]["cancel"])
            assert list(lines)[-4:][0] == "event: done"
    finally:
        http.delete(mesh["links"]["self"])
