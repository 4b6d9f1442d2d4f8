"""The message about compiling."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from equimesh_cli.report import announce_compiling

COMMAND = [sys.executable, "-m", "equimesh_cli"]


@pytest.mark.everything  # it compiles all kernels anew
def test_solve_says_when_it_has_to_compile(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    variables = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    said = []
    for _ in range(2):
        command = [*COMMAND, "solve", "x*y", "-n", "9", "--monitor", "arc-length"]  # fewer kernels than auto
        done = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=300, check=True)
        said.append(done.stderr)
    assert said == ["Compiling the numerical loops, once in this environment ...\n", ""]


def test_the_message_comes_once_and_not_for_loops_of_other_packages(capsys: pytest.CaptureFixture[str]) -> None:
    numba = pytest.importorskip("numba")
    from equimesh.compiling import SENTENCE
    from equimesh.numerics import compiled

    def compile_twice() -> None:
        for value in (1, 1.0):
            loop = numba.njit(lambda x: x)
            compiled._loops.append(loop)
            loop(value)
            compiled._loops.remove(loop)

    with announce_compiling():
        numba.njit(lambda x: x)(1)
    assert capsys.readouterr().err == ""
    with announce_compiling():
        compile_twice()
    assert capsys.readouterr().err == f"{SENTENCE} ...\n"
    with announce_compiling(shown=False):
        compile_twice()
    assert capsys.readouterr().err == ""
