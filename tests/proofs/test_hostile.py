"""The service answers whatever is sent: bodies of any bytes, and large ones on every route."""

from __future__ import annotations

import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.conftest import small
from service.guarded import Guarded
from service.observed import Observed


@settings(max_examples=10, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(body=st.binary(max_size=200))
def test_no_body_breaks_the_service(http: httpx.Client, body: bytes) -> None:
    for kind in ("application/json", "multipart/form-data; boundary=b", "text/csv", "application/x-npz"):
        for path in ("/v1/meshes", "/v1/previews", "/v1/samples", "/v1/expressions/check"):
            answer = http.post(path, content=body, headers={"Content-Type": kind})
            assert answer.status_code in (400, 415, 422), (path, kind, answer.text)
            assert answer.headers["content-type"] == "application/problem+json"


# Bodies ------------------------------------------------------------------------------------------------------

# The size of a body of each kind, and of one on each route; all other bodies are short ones, which no worker reads.
LARGE = 20_000_000
SHORT = 200_000
LARGE_OF_ROUTE = 3
JSON = "application/json"
MULTIPART = "multipart/form-data; boundary=b"
PART = b'--b\r\nContent-Disposition: form-data; name="%s"; filename="u.npz"\r\n'
# The most that the process of the service may grow while it answers.
MAX_GROWTH_MIB = 300
# The most processor time of the process of the service for one body, several times what is needed: its loop is not
# silent for longer than that. Without bounds 20 MB of lists took 7 s.
MAX_SECONDS = 3.0
# No answer of /livez takes this long, however busy the machine is; without bounds a body took a minute.
MAX_SILENT_SECONDS = 30.0


def repeated(piece: bytes, size: int, start: bytes = b"", end: bytes = b"") -> list[bytes]:
    """A body in parts of some 256 KiB, of which all but a few are one: most are refused before much of them is sent."""
    count, at_once = size // len(piece), max(1, 2**18 // len(piece))
    return [start, *[piece * at_once] * (count // at_once), piece * (count % at_once) + end]


BODIES: dict[str, tuple[str, Callable[[int], list[bytes]]]] = {
    "keys": (JSON, lambda size: repeated(b"".join(b'"k%d":1,' % k for k in range(1000)), size, b"{", b'"k":1}')),
    "deep lists": (JSON, lambda size: repeated(b"[", size)),
    "a long number": (JSON, lambda size: repeated(b"7", size, b"[", b"]")),
    "lists": (JSON, lambda size: repeated(b"[1],", size, b'{"monitor":{"u":[', b"1]}}")),
    "numbers": (JSON, lambda size: repeated(b"1,", size, b'{"step":0,"u":{"nodes":[[', b"1]]}}")),
    "a long text": (JSON, lambda size: repeated(b"x", size, b'{"expression":"', b'"}')),
    "texts": (JSON, lambda size: repeated(b'"\\n",', size, b"[", b"1]")),
    "no UTF-8": (JSON, lambda size: repeated(b"\xff\xfe", size)),
    "blanks": (JSON, lambda size: repeated(b" ", size, b"{", b"}")),
    "many parts": (MULTIPART, lambda size: repeated(PART % b"spec" + b"\r\n{}\r\n", size, b"", b"--b--\r\n")),
    "huge headers": (MULTIPART, lambda size: repeated(b"X: y\r\n", size, PART % b"spec", b"\r\n{}\r\n--b--\r\n")),
    "line ends": (MULTIPART, lambda size: repeated(b"\r\n--", size, PART % b"spec" + b"\r\n", b"\r\n--b--\r\n")),
    "a large part": (MULTIPART, lambda size: repeated(b"x", size, PART % b"samples" + b"\r\n", b"\r\n--b--\r\n")),
    "binary": ("application/x-npz", lambda size: repeated(bytes(range(256)), size)),
    "lines": ("text/csv", lambda size: repeated(b"1,", size)),
}


@dataclass
class Watch:
    """The process of a service, seen from outside: its memory, its processor time, and its longest silence."""

    url: str
    pid: int
    silence: float = 0.0
    _over: threading.Event = field(default_factory=threading.Event)

    def memory(self, name: str) -> int:
        """MiB of a line of /proc/<pid>/status."""
        text = Path(f"/proc/{self.pid}/status").read_text()
        return int(text.partition(f"{name}:")[2].split()[0]) // 1024

    def seconds(self) -> float:
        """Processor time of the process, without its workers."""
        ticks = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")

    def listen(self) -> None:
        """Ask /livez again and again."""
        with httpx.Client(base_url=self.url, timeout=600.0) as client:
            while not self._over.wait(0.02):
                began = time.monotonic()
                assert client.get("/livez").status_code == 200
                self.silence = max(self.silence, time.monotonic() - began)

    @contextmanager
    def listening(self) -> Iterator[None]:
        thread = threading.Thread(target=self.listen)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join()


def routes(document: dict[str, Any]) -> list[tuple[str, str]]:
    """Every method and path of the service, with those that the document leaves out."""
    pages = [("GET", "/"), ("GET", "/docs"), ("GET", "/openapi.json"), ("POST", "/nowhere")]
    listed = [
        (method.upper(), path)
        for path, operations in document["paths"].items()
        for method in operations
        if method in ("get", "head", "post", "put", "patch", "delete")
    ]
    assert len(listed) > 25
    return [*pages, *listed]


def pieces(body: list[bytes], *, chunked: bool) -> Iterator[bytes]:
    """A body as it is sent."""
    for piece in filter(None, body):
        yield b"%x\r\n%b\r\n" % (len(piece), piece) if chunked else piece
    if chunked:
        yield b"0\r\n\r\n"


def sent(url: str, method: str, path: str, kind: str, size: int, *, chunked: bool, secret: str = "") -> int:
    """The status of the answer to a body, which is sent until the answer comes; 0 for a connection that is closed.

    With ``chunked`` the length of the body is not announced.
    """
    media_type, make = BODIES[kind]
    body, place = make(size), urlsplit(url)
    length = "Transfer-Encoding: chunked" if chunked else f"Content-Length: {sum(map(len, body))}"
    head = f"{method} {path} HTTP/1.1\r\nHost: {place.netloc}\r\nContent-Type: {media_type}\r\n{length}\r\n"
    head += f"Authorization: Bearer {secret}\r\n\r\n" if secret else "\r\n"
    with socket.create_connection((place.hostname, place.port), timeout=120) as line:
        with suppress(ConnectionError):
            line.sendall(head.encode())
            for piece in pieces(body, chunked=chunked):
                if select.select([line], [], [], 0)[0]:
                    break
                line.sendall(piece)
        with suppress(ConnectionError):
            answer = line.recv(65536)
            return int(answer.split(b" ", 2)[1]) if answer else 0
    return 0


def test_no_body_on_any_route_holds_up_the_service_or_fills_its_memory(observed: Observed) -> None:
    with httpx.Client(base_url=observed.url, timeout=120) as client:
        document = client.get("/openapi.json").json()
        begun = client.post("/v1/sequences", json=small(monitor={"u": "x*y"}), headers={"Prefer": "wait=300"}).json()
        known = {"/v1/sequences/{id}/steps": begun["links"]["steps"]}
        watch = Watch(observed.url, observed.pid)
        Path(f"/proc/{watch.pid}/clear_refs").write_text("5")  # the peak of its memory begins here
        before, kinds, failures = watch.memory("VmRSS"), [*BODIES], []
        with watch.listening():
            for number, (method, path) in enumerate(routes(document)):
                takes_body = "requestBody" in document["paths"].get(path, {}).get(method.lower(), {})
                target = known.get(path, path.replace("{id}", "m-0").replace("{name}", "x"))
                begin = LARGE_OF_ROUTE * number if takes_body else number
                large = {kinds[(begin + k) % len(kinds)] for k in range(LARGE_OF_ROUTE if takes_body else 1)}
                for kind in kinds if takes_body else large:
                    began, size = watch.seconds(), LARGE if kind in large else SHORT
                    status = sent(observed.url, method, target, kind, size, chunked=number % 2 == 0)
                    if not (status < 500 and watch.seconds() - began < MAX_SECONDS):
                        failures.append((method, path, kind, status, watch.seconds() - began))
                    assert not takes_body or 400 <= status < 500, (path, kind, status)
        assert failures == []
        assert watch.memory("VmHWM") - before <= MAX_GROWTH_MIB
        assert watch.silence < MAX_SILENT_SECONDS


def test_every_key_is_bounded_as_no_key_is(guarded_service: Guarded, document: dict[str, Any]) -> None:
    most = guarded_service.settings.max_body
    for scope in ("read", "write", "admin"):
        _, secret = guarded_service.key(scope)
        for method, path in routes(document):
            if "requestBody" not in document["paths"].get(path, {}).get(method.lower(), {}):
                continue
            target = path.replace("{id}", "m-0")
            for chunked in (False, True):
                status = sent(guarded_service.url, method, target, "keys", 20 * most, chunked=chunked, secret=secret)
                refused = {403} if scope == "read" and path != "/v1/expressions/check" else {404, 413}
                assert status in refused, (scope, path, chunked, status)
