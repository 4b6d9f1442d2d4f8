"""The warm-up of processes: once, and not by compiling in the process that workers are forked from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from equimesh_service.worker import warmth

# As the process that workers are forked from: imports the module, then forks.
FORKED = """
import os
import equimesh_service.worker.warm_fork
from equimesh_service.worker import warmth
assert len(os.listdir("/proc/self/task")) == 1, "a process with threads must not be forked"
warmth.warm_up = None  # a second one would fail
child = os.fork()
if child == 0:
    warmth.warm_up_once()
    os._exit(7 if warmth._is_warm else 8)
raise SystemExit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def run(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **single, **variables}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=300)


def test_a_process_warms_up_once(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    monkeypatch.setattr(warmth, "_is_warm", False)
    monkeypatch.setattr(warmth, "warm_up", lambda: calls.append(1))
    warmth.warm_up_once()
    warmth.warm_up_once()
    assert calls == [1]


@pytest.mark.skipif(sys.platform != "linux", reason="the system counts threads otherwise")
def test_processes_that_are_forked_from_a_warm_one_are_warm() -> None:
    done = run(FORKED)
    assert done.returncode == 7, done.stderr


def test_the_process_that_workers_are_forked_from_does_not_compile(tmp_path: Path) -> None:
    code = "from equimesh_service.worker import warm_fork, warmth; raise SystemExit(7 + warmth._is_warm)"
    done = run(code, NUMBA_CACHE_DIR=str(tmp_path))
    assert (done.returncode, done.stderr) == (7, "")


def test_a_warm_up_that_breaks_is_reported_and_harms_nothing(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken() -> None:
        raise OSError("no memory")

    monkeypatch.setattr(warmth, "_is_warm", False)
    monkeypatch.setattr(warmth, "warm_up", broken)
    warmth.warm_up_unless_compiling()
    assert not warmth._is_warm
    assert "the workers are not forked warm" in caplog.text
