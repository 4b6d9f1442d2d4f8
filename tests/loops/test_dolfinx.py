"""A time-stepper of dolfinx on the meshes of a sequence of a service."""

from __future__ import annotations

import json
import os
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

from equimesh_service import Settings, running

HERE = Path(__file__).parent
PYTHON = "/usr/bin/python3"
# The forms of dolfinx are compiled the first time.
RUN_SECONDS = 600


@pytest.mark.external
@pytest.mark.needs("dolfinx")
def test_a_front_is_followed_with_the_velocity_of_the_mesh(tmp_path: Path) -> None:
    tqdm = find_spec("tqdm")
    assert tqdm.origin is not None
    packages = Path(tqdm.origin).parents[1]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parents[1] / "client"), "OMP_NUM_THREADS": "1"}
    with running(Settings(port=0, workers=1, data_dir=tmp_path, log_level="warning")) as url:
        command = [PYTHON, str(HERE / "with_dolfinx.py"), url, str(packages)]
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=RUN_SECONDS, check=False
        )
    assert done.returncode == 0, done.stderr[-3000:]
    errors = json.loads(done.stdout.splitlines()[-1])
    assert errors["largest velocity"] > 0.5  # the front moves with the velocity 1
    assert errors["uniform"] > 0.1
    assert errors["transfer"] < errors["uniform"]  # both lose most to the steps in time
    assert errors["velocity"] < 0.3 * errors["uniform"], errors
