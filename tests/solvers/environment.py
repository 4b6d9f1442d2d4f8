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
from typing import NoReturn

import pytest

ROOT = Path(__file__).parents[2]
CACHE = ROOT / ".cache" / "consumers"
REQUIREMENTS = Path(__file__).with_name("requirements.txt")
SOURCES = Path(__file__).with_name("requirements-source.txt")
# With this variable the tests fail, and are not skipped, where the environment cannot be made.
NEEDED = "EQUIMESH_TEST_CONSUMERS_NEEDED"
# What a download of the packages may take, about 500 MB.
INSTALL_SECONDS = 400
# What compiling may take.
COMPILE_SECONDS = 900
# How long no other attempt is made after one that failed; the reason is in a file.
SECONDS_BETWEEN = 900


def python_of_consumers(*, from_source: bool = False, compile_it: bool = False) -> Path:
    """The interpreter of the environment. Skips the test where no package index gives the packages.

    ``from_source`` says that the test needs what comes as source; it is skipped where that is not compiled yet, unless
    ``compile_it`` says to do so.
    """
    here = f"{sys.version}\n{REQUIREMENTS.read_text()}\n{_own_packages()}"
    folder = CACHE / hashlib.sha256(here.encode()).hexdigest()[:16]
    compiled = folder / f"compiled {hashlib.sha256(SOURCES.read_bytes()).hexdigest()[:16]}"
    with _alone():
        if not (folder / "made").exists():
            _make(folder)
        if from_source and not compiled.exists():
            if not (compile_it or os.environ.get(NEEDED)):
                pytest.skip(f"what {SOURCES.name} lists has to be compiled for minutes: --everything does it")
            _install(folder, SOURCES, COMPILE_SECONDS)
            compiled.touch()
    return folder / "bin" / "python"


def _make(folder: Path) -> None:
    """A new environment, which also sees the packages of the one that runs the tests."""
    for old in CACHE.glob("*/pyvenv.cfg"):
        shutil.rmtree(old.parent)
    venv.create(folder)
    try:
        _install(folder, REQUIREMENTS, INSTALL_SECONDS, "--only-binary=:all:")
    except BaseException:
        shutil.rmtree(folder)
        raise
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    (packages / "tests.pth").write_text("".join(f"{path}\n" for path in _own_packages()))
    (folder / "made").touch()


def _install(folder: Path, requirements: Path, seconds: float, *options: str) -> None:
    """Install without dependencies: pip must not look for those that come from the environment of the tests."""
    failed = CACHE / f"failed-{requirements.name}"
    if failed.exists() and time.time() - failed.stat().st_mtime < SECONDS_BETWEEN:
        _give_up(failed.read_text())  # the other tests of a run do not try again
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(folder / "bin" / "python")]
    install = [*pip, "install", "--quiet", "--no-deps", "--no-compile", *options, "-r", str(requirements)]
    try:
        done = subprocess.run(install, capture_output=True, text=True, timeout=seconds)
        last = "" if done.returncode == 0 else (done.stderr.strip().splitlines() or ["no reason given"])[-1]
    except subprocess.TimeoutExpired:
        last = f"the packages were not there within {seconds} s"
    if last:
        failed.write_text(f"pip cannot install the packages of {requirements.relative_to(ROOT)}: {last}")
        _give_up(failed.read_text())


def _give_up(reason: str) -> NoReturn:
    (pytest.fail if os.environ.get(NEEDED) else pytest.skip)(reason)
    raise AssertionError(reason)


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
