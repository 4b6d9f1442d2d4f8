"""A service on PostgreSQL: a database of the first release is taken over, meshes are reused, and a server that restarts
or is down is survived."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from sqlalchemy import create_engine

from equimesh_service import Settings, running
from equimesh_service.files.folder import FolderFiles
from equimesh_service.store.store import Store
from service.conftest import SLOW, small, until
from service.databases import Postgres, postgres_server
from service.store.first_release import fill

pytestmark = pytest.mark.needs("postgresql")
WAIT = {"Prefer": "wait=60"}


@dataclass(frozen=True)
class Served:
    """A service, the store that it shares, and the server behind both."""

    http: httpx.Client
    settings: Settings
    store: Store
    server: Postgres


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service on a database as release 0.1 left it, with a server that may be stopped."""
    folder = tmp_path_factory.mktemp("data")
    files = FolderFiles(folder / "files")
    files.prepare(alone=True)
    with files.unfinished(".npz") as path:
        path.write_bytes(b"an old mesh")
        sealed = files.seal(path)
        files.publish(path, sealed, lambda _: False)
    with postgres_server(own=True) as server, server.database() as url:
        engine = create_engine(url)
        fill(engine, sealed.sha256, sealed.size)
        engine.dispose()
        settings = Settings(
            data_dir=folder,
            database_url=url,  # type: ignore[arg-type]
            port=0,
            workers=1,
            max_wait=60,
            poll=0.1,
            log_level="warning",
        )
        store = Store(url)
        with running(settings) as address, httpx.Client(base_url=address, timeout=90.0) as http:
            yield Served(http, settings, store, server)
        store.close()


def ask(served: Served, spec: dict[str, Any], query: str = "") -> dict[str, Any]:
    answer = served.http.post(f"/v1/meshes{query}", json=spec, headers=WAIT)
    assert answer.status_code == 201, answer.text
    mesh: dict[str, Any] = answer.json()
    assert mesh["status"] == "succeeded", mesh["error"]
    assert answer.headers.get("equimesh-reused") == mesh["reused_from"]
    return mesh


def file(served: Served, mesh: dict[str, Any], cells: str = "quad") -> httpx.Response:
    return served.http.get(mesh["links"]["file"], params={"format": "npz", "cells": cells}).raise_for_status()


def test_meshes_of_the_first_release_are_listed_downloaded_and_computed(served: Served) -> None:
    old = served.http.get("/v1/meshes?label=old").json()["items"]
    assert [item["id"] for item in old] == ["m-2", "m-1"]
    assert served.http.get("/v1/meshes/m-1/file?format=npz").content == b"an old mesh"
    until(lambda: served.http.get("/v1/meshes/m-2?wait=10").json()["status"] == "succeeded")


def test_the_same_request_is_answered_with_the_same_mesh(served: Served) -> None:
    first = ask(served, small(label="first"))
    assert first["reused_from"] is None
    again = ask(served, small(label="again", cells="triangle"))
    assert (again["id"] != first["id"], again["reused_from"]) == (True, first["id"])
    assert (again["label"], again["cells"], again["attempts"]) == ("again", "triangle", 0)
    assert (again["quality"], again["certificate"]) == (first["quality"], first["certificate"])
    assert file(served, again).headers["etag"] == file(served, first).headers["etag"]
    anew = ask(served, small(label="anew"), "?reuse=false")
    assert (anew["reused_from"], anew["attempts"]) == (None, 1)
    assert file(served, anew).content == file(served, first).content  # to the last bit
    spec = served.http.get(first["links"]["spec"]).json()
    assert file(served, ask(served, spec, "?reuse=false")).content == file(served, first).content
    other = ask(served, small(grid={"n_xi": 8, "n_eta": 10}))
    assert other["reused_from"] is None
    served.http.delete(first["links"]["self"]).raise_for_status()
    assert file(served, again).headers["etag"] == file(served, anew).headers["etag"]
    assert file(served, again, "triangle").status_code == 200  # made now, of files that are left
    events = served.http.get(again["links"]["events"], headers={"Accept": "application/json"}).json()
    assert ([event["event"] for event in events["items"]], events["done"]) == (["done"], True)


def test_a_mesh_of_exactly_so_many_iterations_is_reused_and_a_failed_one_is_not(served: Served) -> None:
    exactly = small(schwarz={"tolerance": None, "max_iterations": 2})
    assert ask(served, exactly)["reused_from"] is None
    assert ask(served, exactly)["reused_from"] is not None
    never = small(schwarz={"tolerance": 1e-14, "max_iterations": 1, "fallback": False})
    for _ in range(2):
        failed = served.http.post("/v1/meshes", json=never, headers=WAIT).json()
        assert (failed["status"], failed["reused_from"], failed["attempts"]) == ("failed", None, 1)


def test_a_file_that_is_asked_for_is_answered_from_the_earlier_mesh(served: Served) -> None:
    spec = small(grid={"n_xi": 9, "n_eta": 9})
    made = [served.http.post("/v1/meshes?format=vtu", json=spec, headers=WAIT) for _ in range(2)]
    assert [answer.status_code for answer in made] == [201, 201]
    assert made[0].content == made[1].content
    assert [("equimesh-reused" in answer.headers) for answer in made] == [False, True]


def test_a_text_that_the_database_refuses_is_refused_before(served: Served) -> None:
    assert served.http.get("/v1/meshes", params={"label": "a\x00b"}).status_code == 422
    assert served.http.get("/v1/meshes/m-%00").status_code == 404
    assert served.http.get("/v1/samples/s-%00").status_code == 404
    assert served.http.delete("/v1/meshes/%00").status_code == 404
    spec = small(monitor={"kind": "arc_length", "u": {"samples": "\x00"}})
    assert served.http.post("/v1/meshes", json=spec).status_code == 422


def test_a_server_that_restarts_and_one_that_is_down(served: Served, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.CRITICAL)
    running_mesh = served.http.post("/v1/meshes", json=SLOW).json()
    here = running_mesh["links"]["self"]
    until(lambda: served.http.get(here).json()["status"] == "running")
    served.server.stop()
    try:
        answer = served.http.get("/v1/meshes")
        assert (answer.status_code, answer.json()["type"]) == (503, "/problems/unavailable")
        assert "retry-after" in answer.headers
        assert "postgres" not in answer.text.lower()
        posted = served.http.post("/v1/meshes", json=small())
        assert (posted.status_code, posted.json()["type"]) == (503, "/problems/unavailable")
        assert served.http.get("/readyz").status_code == 503
        assert served.http.get("/livez").status_code == 200
    finally:
        served.server.start()
    assert served.http.get("/v1/meshes").status_code == 200  # at once: broken connections are replaced
    until(lambda: served.http.get("/readyz").status_code == 200)
    served.http.post(f"{here}/cancel")
    assert served.http.get(here).json()["status"] == "canceled"
    assert ask(served, small(grid={"n_xi": 10, "n_eta": 8}))["attempts"] == 1


def done(http: httpx.Client) -> float:
    """How many meshes a service has computed."""
    lines = http.get("/metrics").text.splitlines()
    return sum(
        float(line.rpartition(" ")[2])
        for line in lines
        if line.startswith("equimesh_meshes_finished_total{") and 'status="succeeded"' in line
    )


def test_what_has_had_its_time_answers_410(served: Served) -> None:
    mesh = ask(served, small(label="old times"), "?reuse=false")
    text = {"Content-Type": "text/csv"}
    stored = served.http.post("/v1/samples", content=b"x,y,u\n0,0,7\n0,1,1\n1,0,1\n1,1,3\n", headers=text).json()
    while served.store.retention.retire_meshes(-1.0, lambda _: None):
        pass
    while served.store.retention.retire_samples(-1.0, lambda _: None):
        pass
    for address in (*mesh["links"].values(), stored["links"]["self"]):
        answer = served.http.post(address) if address.endswith("/cancel") else served.http.get(address)
        assert (answer.status_code, answer.json()["type"]) == (410, "/problems/gone"), address
    assert served.http.delete(mesh["links"]["self"]).status_code == 410
    assert served.http.get("/v1/meshes/m-none").status_code == 404
