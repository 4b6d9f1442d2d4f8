"""`equimesh demo`, as a process of its own."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest


def test_the_demo(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "equimesh_cli", "demo", "--output", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    assert (done.returncode, done.stderr) == (0, "")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"paper.vtu", "paper.vtk", "paper.xdmf", "paper.png", "paper-convergence.png", "wave.vtu"}
    assert all(path.stat().st_size > 0 for path in (tmp_path / "out").iterdir())
    for words in ("1.6375", "q_eq", "max_q_eq", "interpolation error L2", "wave.png"):
        assert words in done.stdout
    (gain,) = re.findall(r"interpolation gain +([\d.]+) in L2", done.stdout)
    assert float(gain) > 5  # a mesh worth having
    (observed, predicted), *_ = re.findall(r"observed rate ([\d.]+), predicted rate ([\d.]+)", done.stdout)
    assert float(predicted) == pytest.approx(float(observed), rel=0.05)
    assert done.stdout.count("predicted rate") == 1  # that of the default settings leaves out what decides there
