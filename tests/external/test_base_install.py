"""The wheel alone, in a fresh environment: what a user of a service installs. Needs a package index."""

from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

import pytest

pytestmark = pytest.mark.external
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The `bin` of an environment that holds the wheel and what it requires."""
    folder = tmp_path_factory.mktemp("base")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    run(*pip, "wheel", "--no-deps", "-w", str(folder), str(ROOT))
    (wheel,) = folder.glob("equimesh-*.whl")
    venv.create(folder / "env")
    found = folder / "env" / ("Scripts" if sys.platform == "win32" else "bin")
    run(*pip, "--python", str(found / "python"), "install", "--no-compile", str(wheel))
    return found


def run(*command: str, code: int = 0) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_only_the_base_is_installed(bin_folder: Path) -> None:
    code = "from importlib.metadata import distributions; print(*(one.name.lower() for one in distributions()))"
    installed = {*run(str(bin_folder / "python"), "-c", code).split()}
    assert "httpx" in installed
    others = "scipy meshio h5py fastapi pydantic sqlalchemy matplotlib numba dask distributed"
    assert not installed.intersection(others.split())


def test_the_client_imports(bin_folder: Path) -> None:
    code = "import equimesh_client, equimesh_cli; print(equimesh_client.Client().url)"
    assert run(str(bin_folder / "python"), "-W", "error", "-c", code) == "http://127.0.0.1:8000\n"


def test_the_command_runs(bin_folder: Path) -> None:
    assert "--samples FILE" in run(str(bin_folder / "equimesh"), "generate", "--help")
    assert "pip install 'equimesh[solver]'" in run(str(bin_folder / "equimesh"), "solve", "x", code=2)
    message = run(str(bin_folder / "equimesh"), "generate", "x", "--url", "http://127.0.0.1:9", code=3)
    assert message.startswith("equimesh: no equimesh service answers at http://127.0.0.1:9")
