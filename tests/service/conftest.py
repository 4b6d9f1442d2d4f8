"""One service for the whole session, on a free port; tests that break things start their own."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from equimesh_service import Settings, running
from service.databases import Postgres, database, postgres_server
from service.guarded import Guarded, guarded
from service.observed import Observed, observe

PAPER = "(1-exp(15*(x-1)))*sin(pi*y)"
# A solve that takes many seconds: nothing ends it early, and every iteration factorises.
SLOW: dict[str, Any] = {
    "monitor": {"kind": "arc_length", "u": {"expression": PAPER}},
    "grid": {"n_xi": 40, "n_eta": 40},
    "schwarz": {
        "tolerance": None,
        "max_iterations": 1000,
        "subdomains": [4, 1],
        "transmission": {"kind": "linear_robin"},
        "fallback": False,
    },
}


def small(**more: Any) -> dict[str, Any]:
    """A spec that is solved in a moment."""
    return {"monitor": {"kind": "arc_length", "u": {"expression": PAPER}}, "grid": {"n_xi": 8, "n_eta": 9}, **more}


def until(condition: Callable[[], Any], seconds: float = 300.0) -> Any:
    """The first true value of ``condition``; fails after this many seconds, far more than a busy machine takes.

    Most conditions are requests, which take the processor from what is waited for: pauses grow to 60 ms.
    """
    deadline, pause = time.monotonic() + seconds, 0.01
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(pause)
        pause = min(1.25 * pause, 0.06)
    raise AssertionError(f"not within {seconds} s")


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL server."""
    with postgres_server() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[str]:
    """The address of an empty database; tests that use it run with SQLite and with PostgreSQL."""
    with database(request.param, tmp_path, request) as url:
        yield url


@pytest.fixture(scope="session")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    """Small limits, so that they can be reached."""
    return Settings(
        data_dir=tmp_path_factory.mktemp("data"),
        port=0,
        workers=2,
        max_points=20_000,
        max_samples=10_000,
        max_body=2_000_000,
        max_subdomains=16,
        log_level="warning",
        reuse=False,  # whatever other tests have asked for, a mesh is computed
    )


@pytest.fixture(scope="session")
def url(settings: Settings) -> Iterator[str]:
    """The URL of the session's service."""
    with running(settings) as url:
        yield url


@pytest.fixture(scope="session")
def http(url: str) -> Iterator[httpx.Client]:
    """A plain HTTP client."""
    with httpx.Client(base_url=url, timeout=600.0) as client:
        yield client


@pytest.fixture(scope="session")
def finished(http: httpx.Client) -> dict[str, Any]:
    """A mesh that was computed by Schwarz iteration."""
    answer = http.post(
        "/v1/meshes", json=small(schwarz={"overlap": 2}, label="finished"), headers={"Prefer": "wait=300"}
    )
    assert answer.status_code == 201, answer.text
    mesh: dict[str, Any] = answer.json()
    assert mesh["status"] == "succeeded", mesh["error"]
    return mesh


@pytest.fixture(scope="session")
def guarded_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    """A service that requires keys, with small limits; every test creates its own keys."""
    with guarded(tmp_path_factory.mktemp("guarded")) as service:
        yield service


@pytest.fixture(scope="session")
def document(http: httpx.Client) -> dict[str, Any]:
    """The OpenAPI document."""
    found: dict[str, Any] = http.get("/openapi.json").json()
    return found


@pytest.fixture(scope="session")
def observed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Observed]:
    """A service as a process, with its log and its traces."""
    with observe(tmp_path_factory.mktemp("observed")) as service:
        yield service
