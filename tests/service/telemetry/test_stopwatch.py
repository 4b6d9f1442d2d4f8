"""Durations of steps, and the context of a log."""

from __future__ import annotations

import re
from contextvars import copy_context
from types import SimpleNamespace

import pytest

from equimesh_service.telemetry import stopwatch
from equimesh_service.telemetry.log_context import LogContext, choose_request_id, current, enter


def test_parts_follow_one_another(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([10.0, 10.5, 12.0, 12.25])
    monkeypatch.setattr(stopwatch, "time", SimpleNamespace(perf_counter=lambda: next(times)))
    watch = stopwatch.Stopwatch()
    watch.lap("check")
    watch.include({"solve": 1.0, "file": 0.25})
    watch.lap("hand-over")
    watch.lap("check")
    assert watch.laps == {"check": 0.75, "solve": 1.0, "file": 0.25, "hand-over": 0.25}
    assert watch.to_header() == "check;dur=750.00, solve;dur=1000.00, file;dur=250.00, hand-over;dur=250.00"


def test_a_header_never_says_less_than_nothing() -> None:
    watch = stopwatch.Stopwatch()
    watch.include({"solve": 1e6})  # more than this process has seen
    watch.lap("hand-over")
    assert watch.to_header() == "solve;dur=1000000000.00, hand-over;dur=0.00"


def test_the_current_stopwatch_is_that_of_the_task() -> None:
    def outside() -> None:
        stopwatch.lap("nobody")
        stopwatch.include({"nobody": 1.0})

    copy_context().run(outside)
    mine = copy_context()
    watch = mine.run(stopwatch.start)
    mine.run(stopwatch.lap, "check")
    mine.run(stopwatch.include, {"solve": 0.5})
    assert [*watch.laps] == ["check", "solve"]


def test_ids_of_clients_are_taken_when_they_are_sane() -> None:
    for good in ("a", "Run_7.b:c-d", "x" * 64):
        assert choose_request_id(good) == good
    for bad in (None, "", "x" * 65, "a b", "a\n", "ä", 'a"b'):
        assert re.fullmatch("[0-9a-f]{24}", choose_request_id(bad))
    assert choose_request_id(None) != choose_request_id(None)


def test_a_context_lasts_as_long_as_its_with() -> None:
    outer, inner = LogContext(request_id="r-1"), LogContext(request_id="r-2", mesh_id="m-1")
    with enter(outer):
        with enter(inner):
            assert current() is inner
        assert current() is outer
        outer.key_id = "k-1"  # known later than the request
        assert current().to_fields() == {"request_id": "r-1", "key_id": "k-1"}
    assert current().to_fields() == {}
