"""The guard of a service without keys: unknown hosts and foreign origins, on every route of the application."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from sqlalchemy.exc import TimeoutError

from equimesh_service import Settings
from equimesh_service.admission.callers import Callers
from equimesh_service.api.app import create_app
from equimesh_service.store.store import Store
from service.interface import operations, walk

EVIL = "evil.example"
PROBES = {"/livez", "/readyz"}
# What browsers say of a page of another site, and of the same site at another port.
FOREIGN: list[dict[str, str]] = [
    {"Origin": f"http://{EVIL}"},
    {"Origin": "null"},
    {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "no-cors", "Sec-Fetch-Dest": "empty"},
    {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "cors", "Sec-Fetch-Dest": "empty"},
]


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


def kind_of(answer: httpx.Response) -> str:
    assert answer.headers["content-type"] == "application/problem+json"
    found: str = answer.json()["type"]
    return found


@contextmanager
def told(tmp_path: Path, **changes: Any) -> Iterator[tuple[FastAPI, Store]]:
    """The application, whose service has callers and nothing else."""
    settings = Settings(data_dir=tmp_path, **changes)
    app, store = create_app(settings), Store(settings.database)
    store.prepare()
    clock = iter(range(0, 10_000, 5))  # every look is later than the cache
    app.state.service = SimpleNamespace(callers=Callers(store.keys, clock=lambda: float(next(clock))))
    try:
        yield app, store
    finally:
        store.close()


@asynccontextmanager
async def connected(app: FastAPI, url: str) -> AsyncIterator[httpx.AsyncClient]:
    transport = httpx.ASGITransport(app, raise_app_exceptions=False)
    async with httpx.AsyncClient(transport=transport, base_url=url) as client:
        yield client


def test_every_route_but_the_probes_refuses_unknown_hosts_and_foreign_origins(
    http: httpx.Client, document: dict[str, Any]
) -> None:
    routes = list(walk(create_app(Settings()).routes))
    assert {(method, path) for method, path, _ in operations(document)} < set(routes)
    own = {"Host": f"127.0.0.1:{http.base_url.port}"}
    before = http.get("/v1/meshes").json()
    for method, template in routes:
        path = template.replace("{id}", "m-0").replace("{name}", "folded")
        for headers in ({"Host": EVIL}, *({**own, **foreign} for foreign in FOREIGN)):
            answer = http.request(method, path, headers=headers)
            if template in PROBES:
                assert answer.status_code == 200, (method, path, headers)
                continue
            assert answer.status_code == 403, (method, path, headers)
            assert "access-control-allow-origin" not in answer.headers
            if method != "HEAD":
                kind = "unknown-host" if headers["Host"] == EVIL else "foreign-origin"
                assert kind_of(answer) == f"/problems/{kind}", (method, path, headers)
    assert http.get("/v1/meshes").json() == before


def test_a_refusal_says_what_to_do(http: httpx.Client) -> None:
    answer = http.get("/v1/meshes", headers={"Host": EVIL}).json()
    assert f"'{EVIL}'" in answer["detail"]
    assert "EQUIMESH_ALLOWED_HOSTS" in answer["remedy"]
    assert "equimesh keys create" in answer["remedy"]
    answer = http.post("/v1/meshes", headers={"Origin": f"http://{EVIL}"}).json()
    assert f"'http://{EVIL}'" in answer["detail"]
    assert "Host" in answer["remedy"]
    assert "another site" in http.get("/", headers=FOREIGN[2]).json()["detail"]


def test_a_preflight_is_refused_without_a_word_of_permission(http: httpx.Client) -> None:
    asked = {"Origin": f"http://{EVIL}", "Access-Control-Request-Method": "DELETE"}
    answer = http.options("/v1/meshes/m-0", headers=asked)
    assert (answer.status_code, kind_of(answer)) == (403, "/problems/foreign-origin")
    assert not [name for name in answer.headers if name.startswith("access-control")]


def test_its_own_pages_programs_and_links_are_served(http: httpx.Client) -> None:
    port = http.base_url.port
    own = [
        {},
        {"Host": f"localhost:{port}", "Origin": f"http://localhost:{port}", "Sec-Fetch-Site": "same-origin"},
        {"Sec-Fetch-Site": "none", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"},
        {"X-Forwarded-Host": EVIL},  # nobody believes it
    ]
    for headers in own:
        assert http.post("/v1/expressions/check", json={"expression": "x"}, headers=headers).status_code == 200
    link = {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "navigate", "Sec-Fetch-Dest": "document"}
    assert http.get("/docs", headers=link).status_code == 200
    assert http.get("/", headers={"Host": EVIL, "X-Forwarded-Host": "localhost"}).status_code == 403


@pytest.mark.anyio
async def test_hosts_of_the_settings_are_served(tmp_path: Path) -> None:
    with told(tmp_path, allowed_hosts="equimesh, meshes.example.org", host="mesher") as (app, _):
        for url in ("http://equimesh:8000", "https://meshes.example.org", "http://mesher:8000", "http://10.0.0.5:8000"):
            async with connected(app, url) as client:  # which also names the address of the connection
                assert (await client.get("/docs", headers={"Origin": url})).status_code == 200, url
        async with connected(app, "http://other") as client:
            assert kind_of(await client.get("/docs")) == "/problems/unknown-host"
            assert kind_of(await client.get("/docs", headers={"Host": "10.0.0.5"})) == "/problems/unknown-host"


@pytest.mark.anyio
async def test_with_the_first_key_the_key_protects(tmp_path: Path) -> None:
    with told(tmp_path) as (app, store):
        async with connected(app, f"http://{EVIL}") as client:
            assert kind_of(await client.get("/docs")) == "/problems/unknown-host"
            store.keys.create("first", ["read"])
            assert (await client.get("/docs", headers={"Origin": "http://a"})).status_code == 200
            assert kind_of(await client.get("/v1/meshes")) == "/problems/unauthorized"


@pytest.mark.anyio
async def test_a_database_that_is_away_is_no_foreign_origin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> bool:
        raise TimeoutError("no connection is free")

    with told(tmp_path) as (app, store):
        monkeypatch.setattr(store.keys, "exist", fail)
        async with connected(app, f"http://{EVIL}") as client:
            answer = await client.get("/docs")
    assert (answer.status_code, kind_of(answer)) == (503, "/problems/unavailable")


@pytest.mark.parametrize("hosts", ["http://a", "a/b", "a:8000", "a b", "*.a", "[a]"])
def test_a_setting_that_names_no_host_is_refused(hosts: str) -> None:
    with pytest.raises(ValueError, match="is no host: give names and addresses without scheme, port and path"):
        Settings(allowed_hosts=hosts)


def test_a_setting_may_name_hosts_of_every_form() -> None:
    settings = Settings(allowed_hosts=" *, a, b.example.org , 10.0.0.1, ::1,[::2], ")
    assert settings.allowed_host_names == ["*", "a", "b.example.org", "10.0.0.1", "::1", "[::2]"]
