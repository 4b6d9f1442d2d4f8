"""Paths and methods that do not exist."""

from __future__ import annotations

import httpx
import pytest


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
