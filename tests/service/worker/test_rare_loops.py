"""The loops of rare kinds: compiled after the service is ready, by one process that ends with it."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path

import pytest

from equimesh_service.errors import EngineError
from equimesh_service.worker import rare_loops
from equimesh_service.worker.rare_loops import LoopCount, RareLoops
from service.conftest import until

# Says that it runs, then waits for the end of its input, as the process that compiles does.
WAITING = "import pathlib, sys; pathlib.Path(sys.argv[1]).touch(); sys.stdin.read()"
# Says its niceness in place of compiling, and does not end by itself.
ENDLESS = """
import os, time
from equimesh_service.worker import rare_loops, warmth
warmth.warm_up = lambda: (print(os.nice(0), flush=True), time.sleep(600))
rare_loops.compile_all()
"""


def incomplete() -> dict[str, int]:
    return {"compiled": 58, "of": 153}


def test_it_begins_when_the_workers_are_ready_and_ends_with_the_service(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ready: list[bool] = []
    looks: list[int] = []

    def is_ready() -> bool:
        looks.append(1)
        return bool(ready)

    loops = RareLoops(is_ready, incomplete, ("-c", WAITING, str(tmp_path / "runs")))
    with caplog.at_level(logging.INFO):
        loops.start()
        until(lambda: len(looks) > 2)
        assert not loops.are_compiling
        ready.append(True)
        until((tmp_path / "runs").exists)
        assert loops.are_compiling
        loops.stop()
    assert not loops.are_compiling
    assert caplog.messages == ["compiling loops of rare kinds: 58 of 153 are there"]


def test_where_all_loops_are_kept_no_process_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rare_loops.subprocess, "Popen", lambda *_, **__: pytest.fail("starts a process"))
    loops = RareLoops(lambda: True, lambda: {"compiled": 0, "of": 0})
    loops._run()
    assert not loops.are_compiling


def test_a_process_that_fails_is_reported_and_harms_nothing(caplog: pytest.LogCaptureFixture) -> None:
    loops = RareLoops(lambda: True, incomplete, ("-c", "raise SystemExit(3)"))
    loops._run()
    assert not loops.are_compiling
    assert "loops of rare kinds are compiled when they are needed: exit status 3" in caplog.messages


def test_workers_count_the_loops_and_nobody_waits_for_one_that_is_late() -> None:
    asked: list[Future[Mapping[str, int]]] = []

    def ask() -> Future[Mapping[str, int]]:
        asked.append(Future())
        return asked[-1]

    count = LoopCount(ask)
    assert count.latest() == count.latest() == {"compiled": 0, "of": 0}
    assert len(asked) == 1
    asked[0].set_result(incomplete())
    assert count.latest() == incomplete()
    asked[1].set_exception(EngineError("it stops"))
    assert count.latest() == incomplete()
    asked[2].cancel()
    assert count.latest() == incomplete(), "the last one that is known"
    failed: Future[Mapping[str, int]] = Future()
    failed.set_exception(EngineError("it stops"))
    assert LoopCount(lambda: failed).now()["of"] == 0


@pytest.mark.skipif(not hasattr(os, "nice"), reason="the system has no niceness")
def test_the_process_is_of_low_priority_and_ends_when_its_input_is_closed() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDLESS], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert int(process.stdout.readline()) == min(os.nice(0) + rare_loops.NICENESS, 19)
        process.stdin.close()
        assert process.wait(60.0) == 1
