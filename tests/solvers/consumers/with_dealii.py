"""deal.II reads a mesh, says what it holds, and solves on it: dealii.cc, compiled when it is first needed."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import poisson

FORMATS = ("msh",)
SIDES = {1: "left", 2: "right", 3: "bottom", 4: "top"}
SOURCE = Path(__file__).with_name("dealii.cc")
PROGRAMS = SOURCE.parents[3] / ".cache" / "consumers"
CMAKE = """\
cmake_minimum_required(VERSION 3.13)
find_package(deal.II 9.3 REQUIRED)
deal_ii_initialize_cached_variables()
set(CMAKE_BUILD_TYPE Release)
project(consumer CXX)
add_executable(dealii "@source@")
deal_ii_setup_target(dealii)
"""


def program() -> Path:
    """The compiled program; another one after a change of the source."""
    folder = PROGRAMS / f"dealii-{hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:12]}"
    if not (folder / "dealii").exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "CMakeLists.txt").write_text(CMAKE.replace("@source@", str(SOURCE)))
        for command in (["cmake", "."], ["make"]):
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
            if done.returncode:
                raise RuntimeError(f"{command[0]} failed: {done.stdout[-2000:]}{done.stderr[-4000:]}")
    return folder / "dealii"


VERSION = subprocess.run([program()], capture_output=True, text=True, check=True).stdout.strip()


def read(path: str) -> dict[str, Any]:
    """All that the program prints of a mesh."""
    words = [path, *map(str, (poisson.STEEP, poisson.SLANT, poisson.PLACE))]
    done = subprocess.run([program(), *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"deal.II failed: {done.stderr[-4000:]}")
    lines, found = iter(done.stdout.splitlines()), {}
    for line in lines:
        name, count = line.split()
        found[name] = np.array([next(lines).split() for _ in range(int(count))], dtype=float)
    return found


def facts(mesh: dict[str, Any]) -> dict[str, Any]:
    edges, areas = mesh["edges"].astype(int), mesh["cells"][:, 0]
    sides = {side: np.unique(edges[edges[:, 2] == number, :2]) for number, side in SIDES.items()}
    return {"points": mesh["points"][:, :2], "area": areas.sum(), "smallest": areas.min(), "sides": sides}


def solve(mesh: dict[str, Any]) -> Any:
    return mesh["points"][:, 2]
