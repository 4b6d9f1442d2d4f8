"""The site under ``/site``: its files with their headers, and the pages for what is not there or was not built."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from equimesh_service import Settings
from equimesh_service.api import pages
from equimesh_service.api.app import create_app


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
def http(tmp_path_factory: pytest.TempPathFactory) -> Site:
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


def test_every_file_is_answered_with_its_type_and_its_policy(http: Site, folder: Path) -> None:
    for file in (path for path in folder.rglob("*") if path.is_file() and path.name != "404.html"):
        name = file.relative_to(folder).as_posix()
        answer = http.get(f"/site/{name}")
        assert (answer.status_code, answer.content) == (200, file.read_bytes()), name
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self'; style-src 'self'; img-src 'self' data:" in policy
        assert policy.startswith("default-src 'none'; base-uri 'none'")
        head = http.request("HEAD", f"/site/{name}")
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == answer.headers["content-length"]
    assert http.get("/site/_static/site.css").headers["content-type"].startswith("text/css")


def test_a_folder_is_its_index_page_and_links_in_it_stay_below_the_path_of_a_proxy(http: Site, folder: Path) -> None:
    assert http.get("/site/").text == (folder / "index.html").read_text()
    assert http.get("/site/how-to/").text == "How to"
    for path, target in (("/site", "site/"), ("/site/how-to", "how-to/")):
        answer = http.get(path)
        assert (answer.status_code, answer.headers["location"]) == (307, target)
        assert httpx.URL(f"https://example.org/proxy{path}").join(target).path == f"/proxy{path}/"


def test_pages_are_asked_for_again_and_what_they_load_is_kept(http: Site, folder: Path) -> None:
    page = http.get("/site/how-to/adapt.html")
    assert page.headers["cache-control"] == http.get("/site/searchindex.js").headers["cache-control"] == "no-cache"
    again = http.get("/site/how-to/adapt.html", **{"If-None-Match": page.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["content-security-policy"] == page.headers["content-security-policy"]
    assert http.get("/site/_static/site.css").headers["cache-control"] == "max-age=86400"
    (folder / "how-to/adapt.html").write_text("Adapt, again")
    changed = http.get("/site/how-to/adapt.html", **{"If-None-Match": page.headers["etag"]})
    assert (changed.status_code, changed.text) == (200, "Adapt, again")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("path", ["none.html", "how-to/none.html", "a/b/c/", "%2e%2e/secret.txt", "..%2fsecret.txt"])
def test_an_address_that_leads_nowhere_gets_a_page_whose_links_work(http: Site, path: str) -> None:
    answer = http.get(f"/site/{path}")
    assert answer.status_code == 404
    assert "secret" not in answer.text
    assert "{{" not in answer.text
    link = re.search(r'href="([^"]*)"', answer.text)
    assert link is not None
    assert answer.request.url.join(link[1]).path == "/site/index.html"
    assert "script-src 'self'" in answer.headers["content-security-policy"]


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("path", ["%00", "a" * 3000, "how-to/adapt.html/", "how-to//adapt.html"])
def test_a_strange_path_leads_nowhere(http: Site, path: str) -> None:
    assert http.get(f"/site/{path}").status_code == 404


@pytest.mark.usefixtures("folder")
def test_an_address_of_many_folders_gets_a_short_answer(http: Site) -> None:
    answer = http.get(f"/site/{'a/' * 5000}")
    assert answer.status_code == 404
    assert len(answer.content) < 5000


def test_another_build_is_served_without_a_restart(http: Site, folder: Path) -> None:
    assert http.get("/site/new.html").status_code == 404
    (folder / "new.html").write_text("New")
    (folder / "index.html").write_text("A new front page")
    assert http.get("/site/new.html").text == "New"
    (folder / "new.html").unlink()
    assert http.get("/site/new.html").status_code == 404


@pytest.mark.usefixtures("folder")
def test_only_reading_is_possible(http: Site) -> None:
    for path in ("/site", "/site/", "/site/index.html"):
        answer = http.request("POST", path)
        assert answer.status_code == 405
        assert "GET" in answer.headers["allow"]


def test_without_a_built_site_a_page_says_how_to_build_it(
    http: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "FOLDER", tmp_path / "none")
    monkeypatch.setattr(pages, "GUIDE", tmp_path / "none")
    for path in ("/site/", "/site/how-to/adapt.html"):
        answer = http.get(path)
        assert answer.status_code == 404
        assert "<code>" in answer.text
        assert "deploy/site" in answer.text
        assert "<script" not in answer.text
        assert "{{" not in answer.text
        targets = [answer.request.url.join(link).path for link in re.findall(r'href="([^"]*)"', answer.text)]
        assert targets == ["/docs/assets/problem.css", "/", "/docs"]


def test_without_a_built_site_the_guide_is_there_in_its_plain_form(
    http: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "FOLDER", tmp_path / "none")
    begin = http.get("/site")
    assert (begin.status_code, begin.headers["location"]) == (307, "site/")
    assert http.get("/site/how-to").headers["location"] == "how-to/"
    for path in ("/site/", "/site/index.html", "/site/tutorials/first-mesh.html", "/site/examples/index.html"):
        answer = http.get(path)
        assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
        assert "default-src 'none'" in answer.headers["content-security-policy"]
        assert "Back to the page" in answer.text
    picture = http.get("/site/images/uniform-and-adapted.png")
    assert (picture.status_code, picture.headers["content-type"]) == (200, "image/png")
    nowhere = http.get("/site/a/b/none.html")
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
        assert http.get(f"/site/{strange}").status_code == 404
