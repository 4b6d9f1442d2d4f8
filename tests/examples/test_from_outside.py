"""Examples of solvers that fetch their next mesh by themselves: they run, and their meshes help them."""

from __future__ import annotations

import math
import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
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


def test_the_channel_of_the_wake_has_its_sides_in_the_order_of_the_program() -> None:
    pytest.importorskip("matplotlib")
    described = runpy.run_path(str(FOLDER / "cylinder.py"))["channel"](0.5)
    numbers = re.search(r"int (inlet.*);", (FOLDER / "cylinder.edp").read_text())
    assert list(described.mesh.sides) == [part.split(" = ")[0] for part in numbers[1].split(", ")]
    assert len(described.mesh.cells) == 624
    assert not described.mesh.is_folded
    assert described.area == pytest.approx(42 - math.pi / 4, rel=1e-9)


def test_the_step_reads_the_place_of_the_reattachment_from_its_cells() -> None:
    pytest.importorskip("matplotlib")
    example = runpy.run_path(str(FOLDER / "backward_step.py"))
    mesh = example["step"](0.5).mesh
    x, y = mesh.points[mesh.cells].mean(axis=1).T
    along = y * ((x - 6.3) + y)  # its shear on the floor is x - 6.3
    assert example["reattachment"](mesh, np.stack([along, 0 * along], axis=1)) == pytest.approx(6.3, abs=1e-9)
    assert list(mesh.sides) == ["inlet", "outlet", "floor", "wall", "top"]
    values = example["at_nodes"](mesh, np.stack([along, 0 * along], axis=1)).values
    inlet = np.unique(mesh.sides["inlet"])
    assert values[inlet] == pytest.approx(np.tanh(3 * (mesh.points[inlet, 1] - 1)))
    assert np.all(values[np.unique(mesh.sides["floor"])] == 0)


@pytest.mark.external
@pytest.mark.needs("freefem")
def test_a_mesh_follows_the_wake_of_a_cylinder(tmp_path: Path) -> None:
    short = ["--fine", "1", "--settling", "300", "--matching", "50", "--period", "45"]
    said = run_script("cylinder.py", tmp_path, *short)
    initial, moved = (float(found) for found in re.findall(r"624 cells, error of the velocity (\S+),", said))
    assert moved < 0.9 * initial
    assert initial < 0.2
    assert (tmp_path / "cylinder-wake.png").exists()


@pytest.mark.external
@pytest.mark.needs("openfoam")
def test_a_mesh_follows_the_stream_behind_a_step(tmp_path: Path) -> None:
    said = run_script("backward_step.py", tmp_path, "--fine", "2", "--rounds", "1")
    rows = re.findall(r"(\w+): 2816 cells, x = \S+, error (\S+), of the velocity (\S+)", said)
    assert [name for name, *_ in rows] == ["initial", "round1"]
    (initial_x, initial), (adapted_x, adapted) = (map(float, numbers) for _, *numbers in rows)
    assert abs(adapted_x) < 0.5 * abs(initial_x)
    assert adapted < initial
    assert (tmp_path / "backward-step.png").exists()


def run_script(name: str, folder: Path, *options: str) -> str:
    """What a script prints, without a warning; its files go to ``folder``."""
    command = [sys.executable, "-W", "error", str(FOLDER / name), "--output", str(folder), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=RUN_SECONDS, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout
