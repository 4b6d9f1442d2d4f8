"""The service answers whatever is sent: properties over specs that are broken at random."""

from __future__ import annotations

import json
from typing import Any

import httpx
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.conftest import small

BASE: dict[str, Any] = {
    **small(),
    "monitor": {"kind": "arc_length", "u": {"expression": "k*x*y", "parameters": {"k": 2}, "t": 0}, "a": 0.5, "b": 0.1},
    "schwarz": {
        "subdomains": [2, 1],
        "overlap": 2,
        "transmission": {"kind": "linear_robin", "p": 2},
        "ordering": "parallel",
        "tolerance": 1e-6,
        "max_iterations": 5,
        "compare_single_domain": False,
    },
    "domain": {"kind": "rectangle", "x": [0, 1], "y": [0, 1]},
    "mode": "tight",
    "allow_relaxed": False,
    "boundary": "trace",
    "initial": "nested",
    "cells": "quad",
    "label": "hostile",
}


OTHERS: dict[str, Any] = {
    **small(),
    "monitor": {
        "kind": "intersection",
        "monitors": [
            {"kind": "curvature", "u": {"expression": "x*y"}, "norm": "h1", "isotropic": True, "smoothing": 0.1},
            {"kind": "tensor", "m11": {"expression": "2"}, "m12": {"expression": "0"}, "m22": {"expression": "1+x"}},
        ],
    },
    "domain": {
        "kind": "quadrilateral",
        "bottom": {"x": "k*t", "y": "0", "parameters": {"k": 2}},
        "right": {"points": [[2, 0], [2, 1]]},
        "top": {"x": "2*t", "y": "1 + t*(1-t)"},
        "left": {"points": [[0, 0], [-0.1, 0.5], [0, 1]]},
    },
}


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of every value inside ``value``."""
    inner: list[tuple[Any, ...]] = []
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, member in members:
        inner += places(member, (*path, key))
    return [path, *inner]


numbers = st.one_of(
    st.integers(-3, 12), st.sampled_from([10**18, -(10**30), 10**400]), st.floats(allow_nan=True, allow_infinity=True)
)
texts = st.one_of(
    st.text(max_size=12), st.sampled_from(["x", "auto", "upload", "__import__('os')", "x" * 5000, "\x00"])
)
values = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, texts),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)


@settings(
    max_examples=200, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_no_spec_breaks_the_service(http: httpx.Client, data: st.DataObject) -> None:
    spec = json.loads(json.dumps(data.draw(st.sampled_from([BASE, OTHERS]))))
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from(places(spec)))
        value = data.draw(values)
        if not path:
            spec = value
            break
        here = spec
        for key in path[:-1]:
            here = here[key]
        here[path[-1]] = value
    body = json.dumps(spec).encode("utf-8", "surrogatepass")
    answer = http.post("/v1/meshes", content=body, headers={"Content-Type": "application/json"})
    if answer.status_code in (201, 202):
        assert http.delete(answer.headers["location"]).status_code == 204
        return
    assert answer.status_code in (400, 422), answer.text
    problem = answer.json()
    assert problem["type"] in ("/problems/invalid-input", "/problems/malformed-body")
    for entry in problem.get("errors", []):
        assert entry["message"]
        assert entry["pointer"] == "" or entry["pointer"].startswith("/")


@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(body=st.binary(max_size=200))
def test_no_body_breaks_the_service(http: httpx.Client, body: bytes) -> None:
    for kind in ("application/json", "multipart/form-data; boundary=b", "text/csv", "application/x-npz"):
        for path in ("/v1/meshes", "/v1/samples", "/v1/expressions/check"):
            answer = http.post(path, content=body, headers={"Content-Type": kind})
            assert answer.status_code in (400, 415, 422), (path, kind, answer.text)
            assert answer.headers["content-type"] == "application/problem+json"


def test_the_service_is_still_well(http: httpx.Client) -> None:
    assert http.get("/readyz").status_code == 200
    assert http.post("/v1/meshes", json=small(), headers={"Prefer": "wait=30"}).json()["status"] == "succeeded"
