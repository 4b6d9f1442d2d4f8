"""The site, the workbench, and the guard of a service without keys: types, policies, unknown hosts and origins."""

from __future__ import annotations

import asyncio
import re
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
from equimesh_service.api import pages
from equimesh_service.api.app import create_app
from equimesh_service.api.pages import workbench_files
from equimesh_service.store.store import Store
from service.interface import operations, walk


class Site:
    """A client of the application alone: these routes need no service behind it."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app

    def request(self, method: str, path: str, **headers: str) -> httpx.Response:
        """The answer to one request; redirects are not followed."""

        async def send() -> httpx.Response:
            transport = httpx.ASGITransport(self._app)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
                return await client.request(method, path, headers=headers)

        return asyncio.run(send())

    def get(self, path: str, **headers: str) -> httpx.Response:
        return self.request("GET", path, **headers)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return Site(create_app(Settings(data_dir=tmp_path_factory.mktemp("data"))))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small site in place of the built one, next to a file that is not part of it."""
    built = tmp_path / "site"
    texts = {
        "index.html": '<a href="how-to/">How to</a>',
        "404.html": '<a href="{{root}}index.html">Front page</a>',
        "how-to/index.html": "How to",
        "how-to/adapt.html": "Adapt",
        "_static/site.css": "p { color: red }",
        "searchindex.js": "Search.setIndex({})",
    }
    for name, text in texts.items():
        (built / name).parent.mkdir(parents=True, exist_ok=True)
        (built / name).write_text(text)
    (tmp_path / "secret.txt").write_text("secret")
    monkeypatch.setattr(pages, "FOLDER", built)
    return built


def test_every_file_is_answered_with_its_type_and_its_policy(reader: Site, folder: Path) -> None:
    for file in (path for path in folder.rglob("*") if path.is_file() and path.name != "404.html"):
        name = file.relative_to(folder).as_posix()
        answer = reader.get(f"/site/{name}")
        assert (answer.status_code, answer.content) == (200, file.read_bytes()), name
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'; style-src 'self'; img-src 'self' data:" in policy
        assert policy.startswith("default-src 'none'; base-uri 'none'")
        head = reader.request("HEAD", f"/site/{name}")
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == answer.headers["content-length"]
    assert reader.get("/site/_static/site.css").headers["content-type"].startswith("text/css")


def test_a_folder_is_its_index_page_and_links_in_it_stay_below_the_path_of_a_proxy(reader: Site, folder: Path) -> None:
    assert reader.get("/site/").text == (folder / "index.html").read_text()
    assert reader.get("/site/how-to/").text == "How to"
    for path, target in (("/site", "site/"), ("/site/how-to", "how-to/")):
        answer = reader.get(path)
        assert (answer.status_code, answer.headers["location"]) == (307, target)
        assert httpx.URL(f"https://example.org/proxy{path}").join(target).path == f"/proxy{path}/"


def test_pages_are_asked_for_again_and_what_they_load_is_kept(reader: Site, folder: Path) -> None:
    page = reader.get("/site/how-to/adapt.html")
    assert page.headers["cache-control"] == reader.get("/site/searchindex.js").headers["cache-control"] == "no-cache"
    again = reader.get("/site/how-to/adapt.html", **{"If-None-Match": page.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["content-security-policy"] == page.headers["content-security-policy"]
    assert reader.get("/site/_static/site.css").headers["cache-control"] == "max-age=86400"
    (folder / "how-to/adapt.html").write_text("Adapt, again")
    changed = reader.get("/site/how-to/adapt.html", **{"If-None-Match": page.headers["etag"]})
    assert (changed.status_code, changed.text) == (200, "Adapt, again")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("path", ["none.html", "how-to/none.html", "a/b/c/", "%2e%2e/secret.txt", "..%2fsecret.txt"])
def test_an_address_that_leads_nowhere_gets_a_page_whose_links_work(reader: Site, path: str) -> None:
    answer = reader.get(f"/site/{path}")
    assert answer.status_code == 404
    assert "secret" not in answer.text
    assert "{{" not in answer.text
    link = re.search(r'href="([^"]*)"', answer.text)
    assert answer.request.url.join(link[1]).path == "/site/index.html"
    assert "script-src 'self'" in answer.headers["content-security-policy"]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("path", ["%00", "a" * 3000, "how-to/adapt.html/", "how-to//adapt.html"])
def test_a_strange_path_leads_nowhere(reader: Site, path: str) -> None:
    assert reader.get(f"/site/{path}").status_code == 404


@pytest.mark.usefixtures("folder")
def test_an_address_of_many_folders_gets_a_short_answer(reader: Site) -> None:
    answer = reader.get(f"/site/{'a/' * 5000}")
    assert answer.status_code == 404
    assert len(answer.content) < 5000


def test_another_build_is_served_without_a_restart(reader: Site, folder: Path) -> None:
    assert reader.get("/site/new.html").status_code == 404
    (folder / "new.html").write_text("New")
    (folder / "index.html").write_text("A new front page")
    assert reader.get("/site/new.html").text == "New"
    (folder / "new.html").unlink()
    assert reader.get("/site/new.html").status_code == 404


@pytest.mark.usefixtures("folder")
def test_only_reading_is_possible(reader: Site) -> None:
    for path in ("/site", "/site/", "/site/index.html"):
        answer = reader.request("POST", path)
        assert answer.status_code == 405
        assert "GET" in answer.headers["allow"]


def test_without_a_built_site_a_page_says_how_to_build_it(
    reader: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "FOLDER", tmp_path / "none")
    monkeypatch.setattr(pages, "GUIDE", tmp_path / "none")
    for path in ("/site/", "/site/how-to/adapt.html"):
        answer = reader.get(path)
        assert answer.status_code == 404
        assert "<code>" in answer.text
        assert "deploy/site" in answer.text
        assert "<script" not in answer.text
        assert "{{" not in answer.text
        targets = [answer.request.url.join(link).path for link in re.findall(r'href="([^"]*)"', answer.text)]
        assert targets == ["/docs/assets/problem.css", "/", "/docs"]


def test_without_a_built_site_the_guide_is_there_in_its_plain_form(
    reader: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "FOLDER", tmp_path / "none")
    begin = reader.get("/site")
    assert (begin.status_code, begin.headers["location"]) == (307, "site/")
    assert reader.get("/site/how-to").headers["location"] == "how-to/"
    for path in ("/site/", "/site/index.html", "/site/tutorials/first-mesh.html", "/site/examples/index.html"):
        answer = reader.get(path)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert "Back to the page" in answer.text
    picture = reader.get("/site/images/uniform-and-adapted.png")
    assert (picture.status_code, picture.headers["content-type"]) == (200, "image/png")
    nowhere = reader.get("/site/a/b/none.html")
    assert (nowhere.status_code, nowhere.request.url.join("../../").path) == (404, "/site/")
    assert 'href="../../../docs/assets/problem.css"' in nowhere.text
    for strange in (
        "%2e%2e/pyproject.toml",
        "..%2fpyproject.toml",
        "%00",
        "conf.py",
        "generator/places.py",
        "a/" * 5000,
    ):
        assert reader.get(f"/site/{strange}").status_code == 404


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


POLICY = "Content-Security-Policy"


def test_the_page_runs_and_loads_only_what_the_service_sends(http: httpx.Client) -> None:
    page = http.get("/")
    policy = dict(rule.split(" ", 1) for rule in page.headers[POLICY].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert not re.search(r"<style|style=|<script(?![^>]* src=)|\son\w+=", page.text)


def test_every_file_is_served_with_its_type(http: httpx.Client) -> None:
    names = {*workbench_files()} - {"index.html"}
    assert {"main.js", "workbench.css", "drawing/webgl.js", "panels/function.js", "icon.svg"} <= names
    for name in names:
        answer = http.get(f"/workbench/{name}")
        assert answer.status_code == 200, name
        assert answer.content == workbench_files()[name].content
        assert answer.headers["content-type"].split(";")[0] == workbench_files()[name].media_type


def test_every_import_of_a_script_leads_to_a_file() -> None:
    files = workbench_files()
    scripts = {name: file.content.decode() for name, file in files.items() if name.endswith(".js")}
    imports = [(name, found) for name, text in scripts.items() for found in re.findall(r' from "(.+?)";', text)]
    assert len(imports) > len(scripts) / 2
    for name, found in imports:
        parts = name.split("/")[:-1]
        for part in found.split("/"):
            parts = parts[:-1] if part == ".." else parts if part == "." else [*parts, part]
        assert "/".join(parts) in files, (name, found)


def test_an_unchanged_file_is_not_sent_again(http: httpx.Client) -> None:
    first = http.get("/workbench/main.js")
    assert first.headers["cache-control"] == "no-cache"
    again = http.get("/workbench/main.js", headers={"If-None-Match": first.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert http.get("/workbench/main.js", headers={"If-None-Match": '"another"'}).status_code == 200


@pytest.mark.parametrize("path", ["none.js", "../settings.py", "%2e%2e/settings.py", "index.html", "drawing", ""])
def test_nothing_else_is_served(http: httpx.Client, path: str) -> None:
    assert http.get(f"/workbench/{path}").status_code == 404
