"""The benchmarks run: what they print is for reading, that they print it is for testing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).parent.parent / "benchmarks"


def test_chord_against_newton() -> None:
    command = [sys.executable, BENCHMARKS / "chord_against_newton.py", "--points", "17", "33", "--runs", "1"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in printed.splitlines()[-2:]]
    assert [row[0] for row in rows] == ["17", "33"]
    assert all(float(row[-1]) < 1e-9 for row in rows), "the two solvers give different meshes"
