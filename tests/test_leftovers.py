"""Processes that a run of tests has left behind are found by their mark, and ended."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import leftovers
from service.conftest import until
from service.processes import runs

pytestmark = pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="there is no /proc")
# Starts a process that outlives it in a session of its own, as servers do.
START = """
import subprocess, sys
command = [sys.executable, "-c", "import time; print('on', flush=True); time.sleep(600)"]
silent = subprocess.DEVNULL
child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=silent, start_new_session=True, text=True)
child.stdout.readline()
print(child.pid)
"""


def start(name: str) -> int:
    """The number of a process with this mark, whose parent has ended."""
    variables = {**os.environ, leftovers.VARIABLE: name}
    command = [sys.executable, "-c", START]
    done = subprocess.run(command, env=variables, stdout=subprocess.PIPE, text=True, check=True)
    return int(done.stdout)


def test_what_is_left_is_ended_and_nothing_else(tmp_path: Path) -> None:
    name, another = f"{tmp_path} a", f"{tmp_path} b"
    mine, others = start(name), start(another)
    try:
        assert [process.pid for process in leftovers.marked(name)] == [mine]
        left = leftovers.end_marked(name)
        assert [process.pid for process in left] == [mine]
        assert "time.sleep(600)" in left[0].command
        until(lambda: not runs(mine))
        assert runs(others)
        assert leftovers.end_marked(name) == []
    finally:
        leftovers.end_marked(another)


def test_this_run_is_marked() -> None:
    name = os.environ[leftovers.VARIABLE]
    found = subprocess.run(
        [sys.executable, "-c", f"import os; print(os.environ[{leftovers.VARIABLE!r}])"], capture_output=True, text=True
    )
    assert found.stdout.strip() == name
