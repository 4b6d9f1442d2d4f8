"""Examples of solvers that fetch their next mesh by themselves: they run, and their meshes help them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from equimesh_service import Settings, running

FOLDER = Path(__file__).parents[2] / "examples" / "from_outside"
# The service compiles its kernels when it is new.
RUN_SECONDS = 300


def environment(**more: str) -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return {**os.environ, "PATH": path, **more}


@pytest.mark.external
@pytest.mark.needs("freefem")
@pytest.mark.needs("curl")
def test_freefem_fetches_its_next_mesh(tmp_path: Path) -> None:
    for name in ("freefem.edp", "fetch"):
        shutil.copy(FOLDER / name, tmp_path)
    env = environment(FF_LOADPATH=os.environ.get("FF_LOADPATH", "/usr/lib/freefem++"))
    with running(Settings(port=0, workers=1, data_dir=tmp_path / "service", log_level="warning")) as url:
        command = ["FreeFem++-nw", "-ne", "-v", "0", "freefem.edp", "-url", url, "-n", "17", "-rounds", "2"]
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
