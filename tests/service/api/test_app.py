"""The OpenAPI document is valid, complete and true; health, unknown paths, and errors that nobody expected."""

from __future__ import annotations

import logging
import re
from typing import Any

import httpx
import jsonschema
import pytest
from fastapi import FastAPI
from starlette.types import Receive, Scope, Send

from equimesh_service import Settings
from equimesh_service.api.app import create_app
from equimesh_service.api.mesh_requests import EXAMPLES
from equimesh_service.api.middleware import Observation
from equimesh_service.problems.problem import KINDS
from equimesh_service.telemetry import logs
from equimesh_service.upkeep.metrics import Metrics
from service.conftest import small, until


def validator(document: dict[str, Any], name: str) -> jsonschema.Draft202012Validator:
    schema = {"$ref": f"#/components/schemas/{name}", "components": document["components"]}
    return jsonschema.Draft202012Validator(schema)


def operations(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {
        f"{method.upper()} {path}": operation
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    }


def references(value: Any) -> set[str]:
    if isinstance(value, dict):
        own = {value["$ref"]} if isinstance(value.get("$ref"), str) else set()
        return own.union(*(references(member) for member in value.values()))
    return set().union(*(references(member) for member in value)) if isinstance(value, list) else set()


def test_the_document_is_well_formed(document: dict[str, Any]) -> None:
    assert document["openapi"].startswith("3.1")
    for name, schema in document["components"]["schemas"].items():
        jsonschema.Draft202012Validator.check_schema(schema)
        assert re.fullmatch(r"[A-Za-z]+", name)
    for reference in references(document):
        assert reference.removeprefix("#/components/schemas/") in document["components"]["schemas"], reference
    ids = [operation["operationId"] for operation in operations(document).values()]
    assert len(ids) == len(set(ids))


def test_every_route_is_described(document: dict[str, Any]) -> None:
    pages = {"/docs", "/", "/workbench/{path}", "/docs/assets/{name}", "/openapi.json"}
    asked = {
        "/v1/meshes", "/v1/meshes/{id}", "/v1/meshes/{id}/events", "/v1/meshes/{id}/cancel", "/v1/meshes/{id}/file",
        "/v1/meshes/{id}/quality", "/v1/meshes/{id}/convergence", "/v1/meshes/{id}/plot", "/v1/meshes/{id}/drawing",
        "/v1/meshes/{id}/spec", "/v1/meshes/{id}/parts", "/v1/meshes/{id}/parts/{number}", "/v1/previews",
        "/v1/sequences", "/v1/sequences/{id}", "/v1/sequences/{id}/steps",
        "/v1/samples", "/v1/samples/{id}", "/v1/expressions/check", "/v1/capabilities", "/livez", "/readyz",
        "/problems/{name}", "/metrics",
    }  # fmt: skip
    assert set(document["paths"]) == asked
    assert not pages & set(document["paths"])
    for name, operation in operations(document).items():
        assert operation["summary"], name
        assert operation["description"], name
        for parameter in operation.get("parameters", []):
            assert parameter["in"] == "path" or parameter["description"], f"{name} {parameter['name']}"
        for status, response in operation["responses"].items():
            assert response["description"], f"{name} {status}"
            if int(status) >= 400 and not name.endswith(" /readyz"):
                assert list(response["content"]) == ["application/problem+json"], f"{name} {status}"


def test_every_key_of_the_spec_is_described(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    assert {"MeshSpec", "Schwarz", "GridValues", "ExpressionSource", "MeshEvents"} <= set(schemas)
    assert schemas["MeshSpec"]["additionalProperties"] is False
    assert list(schemas["MeshSpec"]["properties"]) == [
        "monitor", "domain", "grid", "target", "boundary", "initial", "schwarz", "mode", "allow_relaxed", "cells",
        "label", "parts",
    ]  # fmt: skip


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_work(http: httpx.Client, document: dict[str, Any], name: str) -> None:
    spec = EXAMPLES[name]["value"]
    validator(document, "MeshSpec").validate(spec)
    name = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=300"}).json()["id"]
    mesh = until(
        lambda: (found := http.get(f"/v1/meshes/{name}").json())["status"] not in ("queued", "running") and found
    )
    assert mesh["status"] == "succeeded", mesh
    validator(document, "MeshResource").validate(mesh)


def test_the_answers_are_as_described(http: httpx.Client, document: dict[str, Any], finished: dict[str, Any]) -> None:
    links = finished["links"]
    for url, name in (
        (links["convergence"], "ConvergenceHistory"),
        (links["self"], "MeshResource"),
        ("/v1/meshes", "MeshList"),
        (links["spec"], "MeshSpec"),
    ):
        validator(document, name).validate(http.get(url).json())
    events = http.get(links["events"], headers={"Accept": "application/json"}).json()
    validator(document, "MeshEvents").validate(events)
    stored = http.post("/v1/samples", json={"grid": {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2, 3]]}})
    validator(document, "SamplesResource").validate(stored.json())
    refused = http.post("/v1/meshes", json=small(cells="hex"))
    validator(document, "ProblemDetails").validate(refused.json())


def test_an_app_is_made_without_touching_anything(settings: Settings) -> None:
    assert isinstance(create_app(settings), FastAPI)


# What Chromium sends.
BROWSER = {"Accept": "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,*/*;q=0.8"}


@pytest.mark.parametrize("name", ["invalid-input", "unauthorized"])
def test_a_problem_is_a_page_in_a_browser_and_json_elsewhere(http: httpx.Client, name: str) -> None:
    page, plain = http.get(f"/problems/{name}", headers=BROWSER), http.get(f"/problems/{name}")
    assert page.headers["content-type"].startswith("text/html")
    assert plain.json() == {
        "type": KINDS[name].type,
        "title": KINDS[name].title,
        "status": KINDS[name].status,
        "remedy": KINDS[name].remedy,
    }
    assert page.headers["vary"] == plain.headers["vary"] == "Accept"
    assert f"<h1>{KINDS[name].title}</h1>" in page.text
    assert str(KINDS[name].status) in page.text
    for other in KINDS:
        assert f'href="{other}"' in page.text
    assert KINDS[name].remedy.split("'")[0] in page.text


def test_an_unknown_problem_names_the_nearest(http: httpx.Client) -> None:
    answer = http.get("/problems/invalid-imput")
    assert answer.status_code == 404
    assert "did you mean 'invalid-input'?" in answer.json()["detail"]


@pytest.mark.parametrize("path", ["", "/events", "/file", "/quality", "/convergence", "/plot", "/spec"])
def test_a_mesh_that_is_not_there(http: httpx.Client, path: str) -> None:
    for name in ("m-nothing", "%00", "%ff%fe", "a" * 500):
        answer = http.get(f"/v1/meshes/{name}{path}")
        assert (answer.status_code, answer.json()["type"]) == (404, "/problems/not-found")


def test_paths_and_methods_that_are_not_there(http: httpx.Client) -> None:
    for path in ("/v2/meshes", "/v1", "/docs/assets/other.js", "/problems/none", "/%2e%2e/etc/passwd"):
        answer = http.get(path)
        assert answer.status_code == 404
        assert answer.headers["content-type"] == "application/problem+json"
    refused = http.put("/v1/meshes", json={})
    assert (refused.status_code, refused.json()["type"]) == (405, "/problems/method-not-allowed")
    assert refused.headers["allow"] == "GET, POST"


def test_the_pages_load_nothing_from_elsewhere(http: httpx.Client) -> None:
    for page in ("/", "/docs"):
        answer = http.get(page)
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/html")
        links = re.findall(r"""(?:src|href)\s*=\s*["']([^"']+)""", answer.text)
        assert links
        for link in links:
            assert "//" not in link, link
            if link == "site" or link.startswith("#"):  # the site is there when it was built
                continue
            assert http.get("/" + link.lstrip("/")).status_code == 200, link
    assert "SwaggerUIBundle" in http.get("/docs/assets/swagger-ui-bundle.js").text


def test_head_is_answered_as_get_on_every_page(http: httpx.Client) -> None:
    assets = ("/docs/assets/problem.css", "/workbench/main.js")
    for page in ("/", "/docs", *assets, "/openapi.json", "/problems/invalid-input", "/livez"):
        whole, head = http.get(page), http.head(page)
        assert (head.status_code, head.content) == (200, b""), page
        assert head.headers["content-type"] == whole.headers["content-type"], page
        assert int(head.headers["content-length"]) == len(whole.content), page
    assert http.head("/docs/assets/none").status_code == 404


class Broken:
    """An application that fails before or during its answer."""

    def __init__(self, *, late: bool) -> None:
        self._late = late

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        assert (scope["type"], receive) != ("websocket", None)
        if self._late:
            await send({"type": "http.response.start", "status": 200, "headers": []})
        raise RuntimeError("a private label")


@pytest.mark.anyio
async def test_what_nobody_expected_is_a_problem_with_the_id_that_the_log_has(caplog: pytest.LogCaptureFixture) -> None:
    metrics = Metrics()
    app = Observation(Broken(late=False), metrics=metrics, tracer=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as http:
        answer = await http.get("/v1/meshes", headers={"X-Request-Id": "r-500"})
    assert (answer.status_code, answer.headers["x-request-id"], answer.json()["request_id"]) == (500, "r-500", "r-500")
    assert answer.json()["type"] == "/problems/internal-error"
    assert "private" not in answer.text
    (record,) = (record for record in caplog.records if record.levelno == logging.ERROR)
    assert "RuntimeError at api/test_app.py" in logs.formatter("text").format(record)
    assert "private" not in logs.formatter("json").format(record)
    assert b'requests_total{method="GET",route="unmatched",status="500"} 1.0' in metrics.scrape("")[0]


@pytest.mark.anyio
async def test_a_failure_within_an_answer_cuts_the_connection() -> None:
    app = Observation(Broken(late=True), metrics=Metrics(), tracer=None)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://here") as http:
        with pytest.raises(RuntimeError):
            await http.get("/")


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"
