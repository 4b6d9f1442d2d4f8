"""Pages of other sites in a real browser: they write nothing to a service without keys, and read nothing from it.

The page sends every request that a page can send, with every simple body, to every writing route of the application.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from browser.chromium import visit
from browser.foreign_site import foreign_site
from equimesh_service import Settings
from equimesh_service.api.app import create_app
from service.conftest import small, until
from service.interface import walk

pytestmark = pytest.mark.needs("chromium")
EVIL = "evil.example"
CSV = "x,y,u\n0,0,0\n0,1,1\n1,0,1\n1,1,2\n"
GRID = {"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}}


@pytest.fixture(scope="module")
def http(page_url: str) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=page_url, timeout=600.0) as client:
        yield client


@pytest.fixture(scope="module")
def ids(http: httpx.Client) -> dict[str, str]:
    """A mesh, samples and a sequence, which a page knows by their ids, and might delete."""
    wait = {"Prefer": "wait=300"}
    mesh = http.post("/v1/meshes", json=small(), headers=wait).json()["id"]
    sequence = http.post("/v1/sequences", json=small(), headers=wait).json()["id"]
    for each in http.get("/v1/meshes").json()["items"]:
        until(lambda each=each: http.get(each["links"]["self"]).json()["finished_at"])
    return {"meshes": mesh, "sequences": sequence, "samples": http.post("/v1/samples", json=GRID).json()["id"]}


QUERY = {"filename": "u.csv", "format": "npz"}  # where a route has these parameters


def plan(ids: dict[str, str], target: str) -> dict[str, Any]:
    """What the page does: every writing route of the application, with an id that is there."""
    routes, app = [], create_app(Settings())
    told = app.openapi()["paths"]
    for method, path in walk(app.routes):
        if method not in {"GET", "HEAD", "OPTIONS"}:
            known = {parameter["name"] for parameter in told[path][method.lower()].get("parameters", [])}
            query = "&".join(f"{name}={value}" for name, value in QUERY.items() if name in known)
            routes.append((method, path.replace("{id}", ids.get(path.split("/")[2], "")) + f"?{query}"))
    assert not any("{" in path for _, path in routes)
    routes.sort(key=lambda route: route[0] == "DELETE")  # last, so that the others find what they write to
    return {"target": target, "routes": routes, "spec": json.dumps(small(label="foreign")), "csv": CSV}


def attack(address: str, profile: Path, **names: str) -> tuple[dict[str, set[Any]], dict[str, int]]:
    """What a page got to know, by the way of its requests, and how many of each it sent."""
    document = visit(address, profile, **names).document
    found = json.loads(unescape(document.split('<pre id="told">')[1].split("</pre>")[0]))
    known: dict[str, set[Any]] = {}
    for way, _, _, seen in found["told"]:
        known.setdefault(way, set()).add(seen)
    return known, found["sent"]


def written(settings: Settings) -> dict[str, list[Any]]:
    """All rows of the database, and all files."""
    with sqlite3.connect(settings.data_dir / "equimesh.sqlite3") as database:
        tables = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        found = {name: sorted(map(repr, database.execute(f"SELECT * FROM {name}"))) for name in tables}
    assert {"meshes", "samples", "sequences", "keys"} <= {*found}
    found["files"] = sorted(str(path) for path in (settings.data_dir / "files").rglob("*") if path.is_file())
    return found


def refused(http: httpx.Client) -> dict[str, float]:
    """How many requests the service has answered with 403, by method."""
    counts: dict[str, float] = {}
    for family in text_string_to_metric_families(http.get("/metrics").text):
        for sample in family.samples:
            if sample.name == "equimesh_http_requests_total" and sample.labels["status"] == "403":
                method = sample.labels["method"]
                counts[method] = counts.get(method, 0) + sample.value
    return counts


def moved(before: dict[str, float], after: dict[str, float]) -> dict[str, float]:
    return {method: after[method] - before.get(method, 0) for method in after if after[method] != before.get(method)}


@pytest.mark.parametrize("host", ["127.0.0.1", EVIL])
def test_a_page_of_another_site_writes_nothing(
    http: httpx.Client, page_settings: Settings, ids: dict[str, str], tmp_path: Path, host: str
) -> None:
    service = str(http.base_url)
    before, count = written(page_settings), refused(http)
    with foreign_site(plan(ids, service.rstrip("/")), service) as port:
        names = {host.replace(".", "_"): "127.0.0.1"}
        known, sent = attack(f"http://{host}:{port}/page", tmp_path, **names)
    assert {seen for each in known.values() for seen in each} == {"blocked"}  # it cannot read a single answer
    arrived = {
        "POST": sent["simple"] + sent["cors"] + sent["beacon"] + sent["submit"],
        "OPTIONS": sent["preflighted"],
        "GET": sent["read"],
    }
    assert min(arrived.values()) >= 2
    until(lambda: all(moved(count, refused(http)).get(method, 0) >= number for method, number in arrived.items()))
    assert written(page_settings) == before


def test_a_page_whose_host_resolves_to_the_service_reads_and_writes_nothing(
    http: httpx.Client, page_settings: Settings, ids: dict[str, str], tmp_path: Path
) -> None:
    service = str(http.base_url)
    port = urlsplit(service).port or 0
    before, count = written(page_settings), refused(http)
    with foreign_site(plan(ids, ""), service, address="127.0.0.2", port=port):
        known, sent = attack(f"http://{EVIL}:{port}/page", tmp_path, evil_example="127.0.0.2")
    assert {seen for each in known.values() for seen in each} == {403}
    arrived = sum(moved(count, refused(http)).values())
    assert arrived >= sum(sent.values()) - sent["beacon"]
    assert written(page_settings) == before


def test_a_visit_under_another_name_gets_the_reason(http: httpx.Client, tmp_path: Path) -> None:
    port = urlsplit(str(http.base_url)).port
    document = visit(f"http://{EVIL}:{port}/v1/meshes", tmp_path, evil_example="127.0.0.1").document
    assert "/problems/unknown-host" in document
    assert "EQUIMESH_ALLOWED_HOSTS" in document
    assert "foreign" not in document


def test_the_same_requests_write_when_nothing_says_who_sends_them(
    http: httpx.Client, page_settings: Settings, ids: dict[str, str], tmp_path: Path
) -> None:
    """So it is the guard that refuses them, and not their bodies that are wrong. It is the last test: it deletes."""
    service = str(http.base_url)
    before = written(page_settings)
    with foreign_site(plan(ids, ""), service, trusted=True) as port:
        known, _ = attack(f"http://127.0.0.1:{port}/page", tmp_path)
    assert {200, 201, 202} & known["simple"]
    assert 403 not in known["simple"] | known["preflighted"]
    assert {201, 202, 204} & known["preflighted"]
    after = written(page_settings)
    assert after["meshes"] != before["meshes"]
    assert after["samples"] != before["samples"]
    assert http.get(f"/v1/meshes/{ids['meshes']}").status_code == 404
