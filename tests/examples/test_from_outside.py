"""Examples of solvers that fetch their next mesh by themselves: they run, and their meshes help them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples" / "from_outside"
# The service compiles its kernels when it is new.
RUN_SECONDS = 300


def environment(**more: str) -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, **more}


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """The address of a service."""
    data, log = tmp_path / "service", tmp_path / "service.log"
    command = [sys.executable, "-m", "equimesh_cli", "serve", "--port", "0", "--data-dir", str(data)]
    with log.open("w") as out, subprocess.Popen(command, stdout=out, stderr=out) as service:
        try:
            for _ in range(600):
                text = log.read_text()
                if "startup complete" in text:
                    break
                try:
                    service.wait(0.1)
                except subprocess.TimeoutExpired:
                    continue
                raise AssertionError(log.read_text())
            found = re.search(r"http://127\.0\.0\.1:[1-9]\d*", log.read_text())
            assert found is not None
            yield found.group()
        finally:
            service.terminate()


@pytest.mark.external
@pytest.mark.needs("freefem")
@pytest.mark.needs("curl")
def test_freefem_fetches_its_next_mesh(address: str, tmp_path: Path) -> None:
    for name in ("freefem.edp", "fetch"):
        shutil.copy(FOLDER / name, tmp_path)
    command = ["FreeFem++-nw", "-ne", "-v", "0", "freefem.edp", "-url", address, "-n", "17", "-rounds", "2"]
    env = environment(FF_LOADPATH=os.environ.get("FF_LOADPATH", "/usr/lib/freefem++"))
    done = subprocess.run(
        command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=RUN_SECONDS, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    errors = [float(found) for found in re.findall(r"round \d: error (\S+)", done.stdout)]
    assert len(errors) == 3
    assert max(errors[1:]) < errors[0] / 3


@pytest.mark.external
@pytest.mark.needs("openfoam")
def test_openfoam_fetches_its_next_mesh(tmp_path: Path) -> None:
    case = tmp_path / "case"
    shutil.copytree(FOLDER / "openfoam", case)
    env = environment(WM_PROJECT_DIR=os.environ.get("WM_PROJECT_DIR", "/usr/share/openfoam"))
    done = subprocess.run(
        ["./Allrun", "1", "33"], cwd=case, env=env, capture_output=True, text=True, timeout=RUN_SECONDS, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    in_front = [int(found) for found in re.findall(r"round \d: (\d+) of \d+ points", done.stdout)]
    assert len(in_front) == 2
    assert in_front[1] > 1.3 * in_front[0]
