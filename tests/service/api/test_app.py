"""The OpenAPI document is valid, complete and true."""

from __future__ import annotations

import re
from typing import Any

import httpx
import jsonschema
import pytest
from fastapi import FastAPI

from equimesh_service import Settings
from equimesh_service.api.app import create_app
from equimesh_service.api.mesh_requests import EXAMPLES
from service.conftest import small


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
    mesh = http.post("/v1/meshes", json=spec, headers={"Prefer": "wait=30"}).json()
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
