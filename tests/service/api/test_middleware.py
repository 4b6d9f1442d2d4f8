"""Unexpected errors, as the middleware answers and logs them."""

from __future__ import annotations

import logging

import httpx
import pytest
from starlette.types import Receive, Scope, Send

from equimesh_service.api.middleware import Observation
from equimesh_service.telemetry import logs
from equimesh_service.upkeep.metrics import Metrics


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
    assert "RuntimeError at api/test_middleware.py" in logs.formatter("text").format(record)
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
