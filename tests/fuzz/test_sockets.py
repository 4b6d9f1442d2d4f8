"""Bytes on the wire that no HTTP library sends: the answer is a refusal or none, and the next request is served."""

from __future__ import annotations

import json
import os
import re
import socket
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest

from service.conftest import small, until

HOST = b"Host: localhost\r\n"
JSON = HOST + b"Content-Type: application/json\r\n"
POST = b"POST /v1/expressions/check HTTP/1.1\r\n" + JSON
CHUNKED = POST + b"Transfer-Encoding: chunked\r\n\r\n"
GOOD = b'{"expression": "x*y"}'
LENGTH = b"Content-Length: %d\r\n" % len(GOOD)
LISTENS = "0A"  # the state of a socket in /proc
# Statuses that may come. With an empty set the connection may also be closed without an answer.
REFUSED = {400}
NONE = set[int]()


def get(path: bytes, more: bytes = b"", version: bytes = b"1.1") -> bytes:
    return b"GET " + path + b" HTTP/" + version + b"\r\n" + HOST + more + b"\r\n"


WIRE: dict[str, tuple[bytes, set[int]]] = {
    "blank lines": (b"\r\n\r\n\r\n", NONE),
    "one word": (b"GET\r\n\r\n", REFUSED),
    "no version": (b"GET /livez\r\n\r\n", REFUSED),
    "another version": (get(b"/livez", version=b"9.9"), {200, 400, 505}),
    "TLS": (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(range(200)) + b"\r\n\r\n", REFUSED),
    "zeros": (bytes(5000) + b"\r\n\r\n", REFUSED),
    "HTTP/2": (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", {400, 404, 405}),
    "no host": (b"GET /livez HTTP/1.1\r\n\r\n", REFUSED),
    "two hosts": (get(b"/livez", HOST), REFUSED),
    "a header without colon": (get(b"/livez", b"nonsense\r\n"), REFUSED),
    "a header with a space": (get(b"/livez", b"X Y: 1\r\n"), REFUSED),
    "a header with a zero": (get(b"/livez", b"X: a\x00b\r\n"), REFUSED),
    "a huge header": (get(b"/livez", b"X: " + b"a" * 200_000 + b"\r\n"), {400, 431}),
    "very many headers": (get(b"/livez", b"X: a\r\n" * 30_000), {400, 431}),
    "a huge path": (get(b"/" + b"a" * 200_000), {400, 414, 431}),
    "a raw byte in the path": (get(b"/v1/meshes/\xff\xfe"), {400, 404}),
    "no UTF-8 in the path": (get(b"/v1/meshes/%ff%fe"), {404}),
    "a zero in the path": (get(b"/v1/meshes/%00"), {404}),
    "a way up": (get(b"/v1/samples/..%2f..%2fetc%2fpasswd?format=npz"), {404}),
    "a plain way up": (get(b"/docs/assets/../../../../etc/passwd"), {404}),
    "no UTF-8 in the query": (get(b"/v1/meshes?label=%ff%fe&cursor=%C3%28"), {422}),
    "a surrogate in the query": (get(b"/v1/meshes?label=%ED%A0%80"), {200}),
    "a zero in the query": (get(b"/v1/meshes?label=%00"), {200, 422}),
    "thousands of parameters": (get(b"/v1/meshes?" + b"&".join(b"limit=%d" % k for k in range(4000))), {400, 422, 431}),
    "only ampersands": (get(b"/v1/meshes?" + b"&" * 10_000), {200, 400}),
    "an absolute address": (get(b"http://elsewhere/livez"), {200, 400, 404}),
    "an asterisk": (b"OPTIONS * HTTP/1.1\r\n" + HOST + b"\r\n", {400, 404, 405}),
    "CONNECT": (b"CONNECT a:443 HTTP/1.1\r\n" + HOST + b"\r\n", {400, 404, 405}),
    "an unknown method": (b"BREW /livez HTTP/1.1\r\n" + HOST + b"\r\n", {400, 405}),
    "an upgrade": (get(b"/livez", b"Connection: Upgrade\r\nUpgrade: websocket\r\n"), {200, 400, 404}),
    "HTTP/1.0": (b"GET /livez HTTP/1.0\r\n\r\n", {200}),
    "no length": (POST + b"\r\n", {400, 411, 422}),
    "a negative length": (POST + b"Content-Length: -5\r\n\r\n", REFUSED),
    "no number as length": (POST + b"Content-Length: 1e3\r\n\r\n", REFUSED),
    "a length of many digits": (POST + b"Content-Length: " + b"9" * 500 + b"\r\n\r\n", {400, 413}),
    "a large length": (POST + b"Content-Length: 99999999999\r\n\r\n", {413}),
    "two lengths": (POST + LENGTH + b"Content-Length: 5\r\n\r\n" + GOOD, REFUSED),
    "a length and chunks": (POST + LENGTH + b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n", {400, 422}),
    "a length too small": (POST + b"Content-Length: 5\r\n\r\n" + GOOD, {400, 422}),
    "no chunk size": (CHUNKED + b"ZZ\r\nabc\r\n0\r\n\r\n", REFUSED),
    "a negative chunk": (CHUNKED + b"-1\r\nabc\r\n0\r\n\r\n", REFUSED),
    "an enormous chunk": (CHUNKED + b"F" * 40 + b"\r\nabc\r\n", REFUSED),
    "a chunk without end": (CHUNKED + b"3\r\nabcdef\r\n0\r\n\r\n", REFUSED),
    "an unknown encoding": (POST + b"Transfer-Encoding: gzip\r\n\r\n", {400, 501}),
    "good chunks": (CHUNKED + b"%x\r\n" % len(GOOD) + GOOD + b"\r\n0\r\n\r\n", {200}),
    "an expectation": (POST + LENGTH + b"Expect: 200-ok\r\n\r\n" + GOOD, {200, 417}),
    "a packed body": (POST + LENGTH + b"Content-Encoding: gzip\r\n\r\n" + GOOD, {415}),
    "a strange wait": (get(b"/v1/meshes/none?wait=1e308"), {404, 422}),
    "a strange range": (get(b"/v1/samples/none?format=npz", b"Range: bytes=-,-,0-\r\n"), {404}),
    "a strange host": (b"GET / HTTP/1.1\r\nHost: <script>\r\n\r\n", {400, 403}),
    "a strange length header": (POST + b"Content-Length: +21\r\n\r\n" + GOOD, REFUSED),
}


def connect(url: str) -> socket.socket:
    place = urlsplit(url)
    return socket.create_connection((place.hostname, place.port), timeout=10)


def exchanged(url: str, data: bytes) -> bytes:
    """The first answer, or what comes until the service hangs up or waits for more."""
    with connect(url) as wire:
        found = b""
        try:
            wire.sendall(data)
            wire.settimeout(10 if data.strip() else 0.2)
            while not is_whole(found) and (part := wire.recv(65536)):
                found += part
        except (ConnectionResetError, BrokenPipeError, TimeoutError):
            pass  # it hung up before all was sent, or waits
    return found


def is_whole(answer: bytes) -> bool:
    head, _, body = answer.partition(b"\r\n\r\n")
    length = re.search(rb"content-length: (\d+)", head, re.IGNORECASE)
    return length is not None and len(body) >= int(length[1])


def statuses(answer: bytes) -> list[int]:
    return [int(status) for status in re.findall(rb"HTTP/1\.[01] (\d{3}) ", answer)]


def connections(url: str) -> int:
    """How many connections of the service, which runs in this process, are open."""
    port = f":{urlsplit(url).port:04X}"
    rows = [line.split() for line in Path("/proc/self/net/tcp").read_text().splitlines()[1:]]
    sockets = {f"socket:[{row[9]}]" for row in rows if row[1].endswith(port) and row[3] != LISTENS}
    return sum(name in sockets for name in open_files())


def open_files() -> list[str]:
    found = []
    for file in Path("/proc/self/fd").iterdir():
        with suppress(FileNotFoundError):
            found.append(os.readlink(file))
    return found


@pytest.mark.parametrize("name", WIRE)
def test_what_is_no_http(fuzz_url: str, fuzz_http: httpx.Client, name: str) -> None:
    data, allowed = WIRE[name]
    answer = exchanged(fuzz_url, data)
    found = statuses(answer)
    assert set(found) <= allowed | REFUSED, answer[:500]
    assert found or not allowed or len(data) > 100_000
    assert b"Traceback" not in answer
    assert fuzz_http.get("/livez").status_code == 200


def test_requests_one_after_the_other_without_waiting(fuzz_url: str) -> None:
    check = POST + LENGTH + b"\r\n" + GOOD
    last = get(b"/livez", b"Connection: close\r\n")
    with connect(fuzz_url) as wire:
        wire.sendall((get(b"/livez") + check + get(b"/nowhere")) * 5 + last)
        found = b""
        while part := wire.recv(65536):
            found += part
    assert statuses(found) == [200, 200, 404] * 5 + [200]


def test_who_hangs_up_leaves_nothing_behind(fuzz_url: str, fuzz_http: httpx.Client) -> None:
    mesh = fuzz_http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=300"}).json()
    until(lambda: fuzz_http.get(mesh["links"]["self"]).json()["status"] == "succeeded")
    body = json.dumps(small()).encode()
    head = b"POST /v1/meshes HTTP/1.1\r\n" + JSON + b"Content-Length: %d\r\n\r\n"
    name = mesh["id"].encode()
    unfinished = [
        b"GET /v1/me",
        head % 100_000 + body,
        head % len(body) + body[:20],
        head % len(body) + body,  # and does not wait for the answer
        get(b"/v1/meshes/" + name + b"/file"),
        get(b"/v1/meshes/" + name + b"/plot?kind=quality"),
        get(b"/v1/meshes/" + name + b"/events"),
        b"POST /v1/samples?filename=u.csv HTTP/1.1\r\n" + HOST + b"Transfer-Encoding: chunked\r\n\r\n5\r\n0,0,1\r\n",
    ]
    before = connections(fuzz_url)
    assert before > 0
    for data in unfinished * 4:
        wire = connect(fuzz_url)
        wire.sendall(data)
        if data.startswith(b"GET"):
            wire.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")  # a reset
        wire.close()
        assert fuzz_http.get("/livez").status_code == 200
    until(lambda: connections(fuzz_url) <= before)
    answer = fuzz_http.post("/v1/meshes", json=small(cells="triangle"), headers={"Prefer": "wait=300"})
    mesh = until(lambda: (m := fuzz_http.get(answer.json()["links"]["self"]).json())["finished_at"] and m)
    assert mesh["status"] == "succeeded"
    assert fuzz_http.get("/readyz").json()["status"] == "ok"
