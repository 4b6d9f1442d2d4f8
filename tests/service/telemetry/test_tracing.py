"""Traces: one from the request into the worker, over a real receiver of OTLP; none when they are off."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import httpx
import pytest

import equimesh_service
from equimesh_service.errors import TracingMissingError
from equimesh_service.store.rows import Claim
from equimesh_service.telemetry import tracing
from equimesh_service.telemetry.tracer import open_tracer
from equimesh_service.worker.job import attempt
from service.conftest import small, until
from service.observed import Observed

SPEC = small(grid={"n_xi": 8, "n_eta": 11})  # nobody else's, so that it is solved and not reused
FILE = "GET /v1/meshes/{id}/file"
TRACE = "0af7651916cd43dd8448eb211c80319c"
CALLER = "b7ad6b7169203331"


def test_one_trace_from_the_client_to_the_solve_and_the_export(observed: Observed) -> None:
    headers = {"traceparent": f"00-{TRACE}-{CALLER}-01"}
    with httpx.Client(base_url=observed.url, headers=headers, timeout=600.0) as http:
        mesh = http.post("/v1/meshes", json=SPEC, headers={"Prefer": "wait=300"}).json()
        assert mesh["status"] == "succeeded"
        assert http.get(mesh["links"]["file"], params={"format": "msh"}).status_code == 200
    wanted = {"POST /v1/meshes", "enqueue", "queue wait", "attempt", "solve", "write", FILE, "export"}
    spans = until(lambda: wanted <= set(found := observed.trace(TRACE)) and found)
    request, attempt, solve = spans["POST /v1/meshes"], spans["attempt"], spans["solve"]
    assert request.parent == CALLER
    assert {spans[name].parent for name in ("enqueue", "queue wait", "attempt")} == {request.id}
    assert {spans[name].parent for name in ("solve", "write")} == {attempt.id}
    assert spans["export"].parent == spans[FILE].id
    assert (request.part, solve.part, spans["export"].part) == ("service", "worker", "worker")
    assert len({request.pid, solve.pid, spans["export"].pid}) == 3
    assert attempt.told == {"equimesh.mesh.id": mesh["id"], "equimesh.mesh.attempt": 1}
    assert (request.told["http.route"], request.told["http.response.status_code"]) == ("/v1/meshes", 201)
    assert request.start <= spans["queue wait"].start <= spans["queue wait"].end <= solve.start <= solve.end
    assert not any(span.failed for span in spans.values())


def test_a_request_without_a_parent_begins_a_trace_of_its_own(observed: Observed) -> None:
    for parent in ({}, {"traceparent": "nonsense"}):
        before = len(observed.spans)
        assert httpx.get(f"{observed.url}/v1/meshes", headers=parent).status_code == 200
        span = until(lambda before=before: next((s for s in observed.spans[before:] if "GET" in s.name), None))
        assert (span.name, span.parent) == ("GET /v1/meshes", "")
        assert span.trace != TRACE


def imports(path: Path) -> set[str]:
    """The modules that a module imports when it is loaded, without those that its functions import."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def test_off_they_load_nothing_and_do_nothing() -> None:
    modules = sorted(Path(equimesh_service.__file__).parent.rglob("*.py"))
    assert [path.stem for path in modules if any("opentelemetry" in name for name in imports(path))] == ["spans"]
    assert not [path.stem for path in modules if "equimesh_service.telemetry.spans" in imports(path)]
    assert open_tracer("", "service") is None
    assert tracing.span("a") is tracing.span("b") is tracing.continue_span("c", f"00-{TRACE}-{CALLER}-01")
    assert tracing.traceparent() is None
    with attempt(Claim("m-1", 1)):
        pass


def test_a_missing_package_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "equimesh_service.telemetry.spans", raising=False)
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.trace", None)
    assert open_tracer("", "service") is None
    with pytest.raises(TracingMissingError, match=r"pip install 'equimesh\[tracing\]', or leave"):
        open_tracer("http://127.0.0.1:1/v1/traces", "service")
