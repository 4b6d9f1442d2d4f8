"""`equimesh demo`, as a process of its own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def test_the_demo(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "equimesh_cli", "demo", "--output", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    assert (done.returncode, done.stderr) == (0, "")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"paper.vtu", "paper.vtk", "paper.xdmf", "paper.png", "paper-convergence.png", "ring.vtu"}
    assert all(path.stat().st_size > 0 for path in (tmp_path / "out").iterdir())
    for words in ("1.6375", "q_eq", "max_q_eq", "interpolation error L2", "ring.png"):
        assert words in done.stdout
