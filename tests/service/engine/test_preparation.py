"""The preparation of a worker process before its first task."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

from equimesh_service import Settings
from equimesh_service.engine import port
from equimesh_service.engine.port import Preparation


def test_a_worker_gets_the_log_and_the_tracer_of_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[Any] = []
    monkeypatch.setattr(port.logs, "configure", lambda *given: done.append(given))
    monkeypatch.setattr(port, "open_tracer", lambda *given: given)
    monkeypatch.setattr(port.tracing, "use", done.append)
    settings = Settings(log_level="error", log_format="json", trace_endpoint="http://traces:4318")
    pickle.loads(pickle.dumps(Preparation.of(settings)))()
    assert done == [("error", "json"), ("http://traces:4318", "worker")]
