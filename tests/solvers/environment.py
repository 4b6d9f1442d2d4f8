"""The environment in which other solvers run: made once, and stored in `.cache/consumers` under the repository."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import sysconfig
import time
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CACHE = ROOT / ".cache" / "consumers"
REQUIREMENTS = Path(__file__).with_name("requirements.txt")
# With this variable the tests fail, and are not skipped, where the environment cannot be made.
NEEDED = "EQUIMESH_TEST_CONSUMERS_NEEDED"
# What a download of the packages may take, about 500 MB.
INSTALL_SECONDS = 400
# The reason why the last attempt failed, and how long no other is made.
FAILED = CACHE / "failed.txt"
SECONDS_BETWEEN = 900


def python_of_consumers() -> Path:
    """The interpreter of the environment. Skips the test where no package index gives the packages."""
    here = f"{sys.version}\n{REQUIREMENTS.read_text()}\n{_own_packages()}"
    folder = CACHE / hashlib.sha256(here.encode()).hexdigest()[:16]
    with _alone():
        if not (folder / "made").exists():
            if FAILED.exists() and time.time() - FAILED.stat().st_mtime < SECONDS_BETWEEN:
                _give_up()  # the other tests of a run do not try again
            _make(folder)
    return folder / "bin" / "python"


def _make(folder: Path) -> None:
    for old in CACHE.glob("*/pyvenv.cfg"):
        shutil.rmtree(old.parent)
    venv.create(folder)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(folder / "bin" / "python")]
    # Without dependencies: pip must not look for those that come from the environment of the tests.
    install = [*pip, "install", "--quiet", "--no-deps", "--no-compile", "-r", str(REQUIREMENTS)]
    try:
        done = subprocess.run(install, capture_output=True, text=True, timeout=INSTALL_SECONDS)
        last = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    except subprocess.TimeoutExpired:
        last = f"the packages did not arrive within {INSTALL_SECONDS} s"
    if last:
        shutil.rmtree(folder)
        FAILED.write_text(f"pip cannot install the packages of {REQUIREMENTS.relative_to(ROOT)}: {last}")
        _give_up()
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (packages / "tests.pth").write_text("".join(f"{path}\n" for path in _own_packages()))
    (folder / "made").touch()


def _give_up() -> None:
    (pytest.fail if os.environ.get(NEEDED) else pytest.skip)(FAILED.read_text())


def _own_packages() -> list[str]:
    """The folders of packages of the environment that runs the tests."""
    return [path for path in sys.path if Path(path).name == "site-packages"]


@contextmanager
def _alone() -> Iterator[None]:
    """Whoever comes second waits until the environment is made."""
    import fcntl

    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
