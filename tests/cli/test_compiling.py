"""The message about compiling."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "equimesh_cli"]


def test_solve_says_when_it_has_to_compile(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = []
    for _ in range(2):
        command = [*COMMAND, "solve", "x*y", "-n", "9"]
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=300, check=True)
        said.append(done.stderr)
    assert said == ["compiling kernels, once per machine ...\n", ""]
