"""The parts of a request: their sum is the time between the first and the last of them."""

from __future__ import annotations

from contextvars import copy_context
from types import SimpleNamespace

import pytest

from equimesh_service.telemetry import stopwatch


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
