"""The head of a request has at most 32 KiB, in whatever pieces it comes."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from urllib.parse import urlsplit

import httpx
import pytest

from equimesh_service.wire.headers import MAX_HEAD_BYTES


@pytest.mark.parametrize("value", [{"X-Long": "a" * MAX_HEAD_BYTES}, {f"X-{k}": "a" * 100 for k in range(600)}])
def test_long_headers_are_refused(http: httpx.Client, value: dict[str, str]) -> None:
    answer = http.get("/livez", headers=value)
    assert (answer.status_code, answer.json()["type"]) == (431, "/problems/headers-too-large")
    assert http.get("/livez").status_code == 200


def test_a_long_query_is_refused(http: httpx.Client) -> None:
    assert http.get("/v1/meshes", params={"label": "a" * MAX_HEAD_BYTES}).status_code == 431


def test_headers_below_the_limit_are_read(http: httpx.Client) -> None:
    assert http.get("/livez", headers={"X-Long": "a" * (MAX_HEAD_BYTES - 1000)}).status_code == 200


def test_a_head_in_pieces_is_refused(url: str) -> None:
    place = urlsplit(url)
    answer = b""
    with socket.create_connection((place.hostname, place.port), timeout=20) as line, suppress(ConnectionError):
        line.sendall(b"GET /livez HTTP/1.1\r\nHost: a\r\nX-Long: ")
        for _ in range(6):
            time.sleep(0.02)
            line.sendall(b"a" * 10_000)
        line.sendall(b"\r\n\r\n")
        answer = line.recv(100)
    assert not answer or answer.split()[1] in (b"400", b"431")  # or it hangs up before all was sent
