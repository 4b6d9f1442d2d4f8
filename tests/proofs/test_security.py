"""Security: headers of answers, secrets, files outside the data folder, slow senders, proxies."""

from __future__ import annotations

import json
import logging
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy.exc import OperationalError

from equimesh_service import Settings
from equimesh_service.api.app import create_app
from equimesh_service.server import _server
from equimesh_service.store.keys import KeyStore
from equimesh_service.store.meshes import MeshesStore
from equimesh_service.telemetry import logs
from equimesh_service.wire import body
from service.conftest import small, until
from service.guarded import Guarded

HEADERS = {
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


@pytest.fixture(scope="module")
def client(guarded_service: Guarded) -> Iterator[httpx.Client]:
    """A client that may write."""
    with guarded_service.client("write") as client:
        yield client


@pytest.fixture(scope="module")
def mesh(client: httpx.Client) -> str:
    """The address of a finished mesh."""
    made = client.post("/v1/meshes", json=small(), headers={"Prefer": "wait=300"})
    assert made.json()["status"] == "succeeded"
    return str(made.headers["location"])


# Headers -----------------------------------------------------------------------------------------------------


def test_every_answer_has_the_headers(guarded_service: Guarded, client: httpx.Client, mesh: str) -> None:
    paths = [
        "/", "/docs", "/docs/assets/docs.js", "/openapi.json", "/livez", "/readyz", "/v1/capabilities", "/v1/meshes",
        "/nowhere", "/v1/meshes/none", "/v1/meshes?limit=x", "/site", mesh, f"{mesh}/file", f"{mesh}/plot?format=png",
        f"{mesh}/plot?format=svg", f"{mesh}/file?format=none", f"{mesh}/events?after=999", f"{mesh}/events",
    ]  # fmt: skip
    answers = [client.get(path) for path in paths]
    answers += [client.put("/v1/meshes"), client.head(f"{mesh}/file"), client.options("/v1/meshes")]
    answers += [
        client.get(f"{mesh}/file", headers=headers) for headers in ({"Range": "bytes=0-9"}, {"Range": "bytes=9999999-"})
    ]
    answers += [httpx.get(f"{guarded_service.url}/v1/meshes"), client.post("/v1/meshes", content=b"x" * 300_000)]
    assert {answer.status_code for answer in answers} >= {200, 204, 206, 307, 401, 404, 405, 406, 415, 416, 422}
    for answer in answers:
        where = f"{answer.status_code} {answer.request.url}"
        assert HEADERS.items() <= dict(answer.headers).items(), where
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; base-uri 'none'"), where
        assert "frame-ancestors 'none'" in policy, where
        scripts = re.search(r"script-src ([^;]*)", policy)
        assert scripts is None or scripts[1] in ("'none'", "'self'"), where
        svg = answer.headers.get("content-type", "").startswith("image/svg")
        assert ("unsafe" in policy) is svg, where
        assert answer.headers["cache-control"], where
        assert "server" not in answer.headers, where
    assert client.get(mesh).headers["cache-control"] == "no-store"


def test_a_failure_has_the_headers_too(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("no")

    monkeypatch.setattr(MeshesStore, "page", fail)
    answer = client.get("/v1/meshes")
    assert answer.status_code == 500
    assert HEADERS.items() <= dict(answer.headers).items()


# Secrets -----------------------------------------------------------------------------------------------------


def _raising(error: Exception) -> Any:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def _failed(client: httpx.Client, *, slowly: bool) -> str:
    """The answer to a request that fails; with ``slowly`` after the cache of callers has expired."""
    if slowly:
        until(lambda: client.get("/v1/meshes").status_code != 200)
    answer = client.get("/v1/meshes")
    assert answer.status_code in (500, 503), answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    return answer.text


def _lines(caplog: pytest.LogCaptureFixture, style: str) -> list[str]:
    """The lines of the service's log in this style."""
    records = [record for record in caplog.records if not record.name.startswith(("httpx", "httpcore"))]
    for record in records:
        record.exc_text = None  # what pytest made of it
    return [*map(logs.formatter(style).format, records)]


@pytest.mark.parametrize("style", ["text", "json"])
def test_no_secret_and_no_stack_is_told(
    guarded_service: Guarded, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, style: str
) -> None:
    row, secret = guarded_service.key("write")
    address = "postgresql+psycopg://equimesh:pa55word@db.example/equimesh"
    down = OperationalError(
        f"SELECT '{secret}'", {"key": secret}, Exception(f"connection to {address.partition('@')[2]}")
    )

    told: list[str] = []
    with guarded_service.having(secret) as client, caplog.at_level(logging.DEBUG):
        told += [client.get(f"/v1/meshes/{secret}").text, client.get("/v1/meshes", params={"cursor": secret}).text]
        told += [client.post("/v1/meshes", json=small(label=7, monitor=secret)).text]
        told += [httpx.get(f"{guarded_service.url}/v1/meshes", headers={"Authorization": f"Bearer {secret}x"}).text]
        for owner, name, error in (
            (MeshesStore, "page", RuntimeError(f"{secret} in {guarded_service.settings.data_dir}")),
            (MeshesStore, "page", PermissionError(13, "denied", str(guarded_service.settings.data_dir / "secret.bin"))),
            (MeshesStore, "page", down),
            (KeyStore, "get", down),
        ):
            with monkeypatch.context() as patch:
                patch.setattr(owner, name, _raising(error))
                told.append(_failed(client, slowly=owner is KeyStore))
        told += [httpx.get(f"{guarded_service.url}/readyz").text]
    lines = _lines(caplog, style)
    assert sum("RuntimeError" in line for line in lines) >= 1  # the log does say what happened, and where
    assert sum("OperationalError" in line for line in lines) >= 1
    for text in (*told, *lines):
        for hidden in (secret[-43:], row.sha256, "pa55word", "Traceback", 'File "'):
            assert hidden not in text, text
    for text in told:
        assert str(guarded_service.settings.data_dir) not in text
        assert ".py" not in text


def test_settings_do_not_show_secrets() -> None:
    settings = Settings(database_url="postgresql+psycopg://u:pa55word@h/n", s3_secret_key="pa55word")  # type: ignore[arg-type]
    assert "pa55word" not in f"{settings!r} {settings} {settings.model_dump_json()}"


# Names -------------------------------------------------------------------------------------------------------

NAMES = [
    "..", "../..", "../../etc/passwd", "..%2f..%2fetc%2fpasswd", "%2e%2e", "%2e%2e/%2e%2e/etc/passwd",
    "%252e%252e%252fpasswd", "....//....//etc/passwd", "/etc/passwd", "%2fetc%2fpasswd", "//etc/passwd", "%00", "m-%00",
    "m-%00.vtu", "C:%5cWindows%5cwin.ini", "..%5c..%5cequimesh.sqlite3", "%5c%5chost%5cshare", "~root",
    "equimesh.sqlite3", "service.lock", "files", "%ff%fe", "%c0%ae%c0%ae%c0%af", "%e2%80%ae", "%0d%0aX-Evil:%201", "%",
    "%zz", "a" * 5000, "%00" * 1000, "'%20OR%20''='", "%24%7bjndi:x%7d", "con", "aux.txt", ".", "%20",
]  # fmt: skip
PLACES = [
    "/v1/meshes/{}", "/v1/meshes/{}/file", "/v1/meshes/{}/plot", "/v1/meshes/{}/events", "/v1/meshes/{}/spec",
    "/v1/samples/{}", "/v1/samples/{}?format=npz", "/docs/assets/{}", "/problems/{}", "/v1/meshes?cursor={}",
    "/v1/meshes?label={}", "/v1/meshes?status={}", "{mesh}/file?format={}", "{mesh}/file?cells={}",
    "{mesh}/plot?kind={}", "/{}",
]  # fmt: skip


def raw(service: Guarded, request: bytes) -> tuple[int, bytes]:
    """The status and the bytes of an answer, to a request that is sent as it is."""
    host, _, port = service.url.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=300) as line:
        line.sendall(request)
        data = bytearray()
        while chunk := line.recv(65536):
            data += chunk
    return int(data.split(b" ", 2)[1] if data else 0), bytes(data)


def test_no_name_leads_out_of_the_data_folder(guarded_service: Guarded, mesh: str, everything: bool) -> None:
    _, secret = guarded_service.key("admin")
    folder = guarded_service.settings.data_dir
    (folder.parent / "outside.txt").write_text("outside the data folder")
    before = listing(folder.parent)
    asked = [
        place.replace("{mesh}", mesh).replace("{}", name) for place in PLACES for name in [*NAMES, "../outside.txt"]
    ]
    asked = asked[:550] if everything else asked[::2]  # a key may ask 600 times in a minute
    for path in asked:
        head = f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\nAuthorization: Bearer {secret}\r\n\r\n"
        status, data = raw(guarded_service, head.encode("latin-1"))
        assert status < 500, path
        for taken in (b"root:", b"SQLite format", b"outside the data", b"X-Evil: 1\r\n", b"[fonts]"):
            assert taken not in data, path
    assert listing(folder.parent) == before


def listing(folder: Path) -> set[tuple[str, int]]:
    """All files outside of the data folder's own, with their sizes."""
    mine = ("equimesh.sqlite3", "unfinished")
    return {
        (str(path), path.stat().st_size)
        for path in folder.rglob("*")
        if path.is_file() and not any(word in str(path) for word in mine)
    }


@pytest.mark.parametrize(
    "name", ["../../u.npz", "/tmp/u.npz", "C:\\u.npz", "u\x00.npz", "..", "a" * 200 + ".npz", "%2e%2e%2fu.csv", ".npz"]
)
def test_no_file_name_leads_out_of_the_data_folder(guarded_service: Guarded, client: httpx.Client, name: str) -> None:
    before = listing(guarded_service.settings.data_dir.parent)
    upload = {"samples": (name, b"x,y,u\n0,0,1\n", "text/csv")}
    spec = json.dumps(small(monitor={"kind": "arc_length", "u": {"samples": "upload"}}, label=name))
    for answer in (
        client.post("/v1/samples", params={"filename": name}, content=b"PK\x03\x04"),
        client.post("/v1/samples", files=upload),
        client.post("/v1/meshes", files=upload, data={"spec": spec}),
        client.post("/v1/meshes", json=small(monitor={"kind": "arc_length", "u": {"samples": name[:90]}})),
    ):
        assert 400 <= answer.status_code < 500, answer.text
    assert listing(guarded_service.settings.data_dir.parent) == before


# Slow senders ------------------------------------------------------------------------------------------------


@contextmanager
def dripping(service: Guarded, number: int, start: bytes) -> Iterator[list[socket.socket]]:
    """This many connections that have sent a beginning, and continue when the test says so."""
    host, _, port = service.url.removeprefix("http://").partition(":")
    lines = [socket.create_connection((host, int(port)), timeout=300) for _ in range(number)]
    try:
        for line in lines:
            line.sendall(start)
        yield lines
    finally:
        for line in lines:
            line.close()


def test_slow_senders_hold_up_nobody(guarded_service: Guarded, client: httpx.Client, mesh: str) -> None:
    body = b"POST /v1/meshes HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 9000\r\n"
    body += f"Authorization: {client.headers['authorization']}\r\n\r\n".encode()
    with dripping(guarded_service, 100, b"GET /v1/meshes HT") as heads, dripping(guarded_service, 50, body) as bodies:
        for _ in range(5):
            for line in (*heads, *bodies):
                line.sendall(b"x")
            # They send nothing more until these answers are there.
            assert client.get(mesh).status_code == 200
            assert httpx.get(f"{guarded_service.url}/livez").status_code == 200


def test_a_body_has_to_come_in_time(client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(body, "BODY_SECONDS", 0.2)

    def drip() -> Iterator[bytes]:
        yield b"{"
        time.sleep(0.6)
        yield b"}"

    answer = client.post("/v1/meshes", content=drip(), headers={"Content-Type": "application/json"})
    assert (answer.status_code, answer.json()["type"]) == (408, "/problems/request-timeout")


# Proxies -----------------------------------------------------------------------------------------------------


def test_what_the_server_is_told_of_proxies(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, trusted_proxies="10.0.0.0/8, 127.0.0.1", root_path="/tools/meshes/")
    config = _server(settings).config
    assert (config.root_path, config.proxy_headers) == ("/tools/meshes", True)
    assert config.forwarded_allow_ips == settings.trusted_proxies
    for wrong in ({"root_path": "meshes"}, {"root_path": "/a b"}, {"trusted_proxies": "proxy.example"}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Settings(**wrong)  # type: ignore[arg-type]


@pytest.mark.anyio
async def test_addresses_are_right_under_a_root_path(tmp_path: Path) -> None:
    """The whole application; its requests here need no workers."""
    settings = Settings(data_dir=tmp_path, root_path="/tools/meshes", workers=1, allowed_hosts="example.org")
    app = create_app(settings)
    async with app.router.lifespan_context(app):
        transport = httpx.ASGITransport(app, root_path=settings.root)
        async with httpx.AsyncClient(transport=transport, base_url="https://example.org/tools/meshes") as client:
            made = await client.post("/v1/meshes", json=small())
            place = made.headers["location"]
            assert place == made.json()["links"]["self"] == f"/tools/meshes/v1/meshes/{made.json()['id']}"
            assert (await client.get(f"https://example.org{place}")).status_code == 200
            await client.post("/v1/meshes", json=small())
            page = await client.get("/v1/meshes?limit=1")
            assert page.headers["link"].startswith("</tools/meshes/v1/meshes?limit=1&cursor=")
            samples = await client.post(
                "/v1/samples", json={"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}
            )
            assert samples.headers["location"].startswith("/tools/meshes/v1/samples/s-")
            front = (await client.get("/")).text
            assert not re.search(r'(?:href|src)="/', front), "addresses of the page are relative"
            assert (await client.get("/openapi.json")).json()["servers"] == [{"url": "/tools/meshes"}]
