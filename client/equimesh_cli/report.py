"""What commands print and show: tables, progress of a compilation, pictures."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from equimesh_cli.parser import NotInstalled

if TYPE_CHECKING:
    from equimesh_client import Certificate


def print_report(certificate: Certificate | None, points: int | str, message: str) -> None:
    """Print what a mesh of so many ``points`` is worth, how the solve ended, and the rest of its certificate.

    The number is empty where it is not known.
    """
    if certificate is None:
        print(f"{points} points: {message}" if points else message)
        return
    print(certificate.headline)
    print(f"{points} points. {message}" if points else message)
    for warning in certificate.warnings:
        print(f"warning: {warning}")
    print(f"\nDetails:\n{certificate.details}")


# Opens a picture with the viewer of the system.

# Programs that open a file with the viewer of the desktop, each with the words before the file.
DESKTOP_OPENERS = (("xdg-open",), ("gio", "open"), ("wslview",))


def open_picture(path: Path) -> bool:
    """Open a file with the system's viewer and do not wait for it; False where there is none, or no display."""
    words = _opener()
    if words is None:
        return False
    nothing = [(os.POSIX_SPAWN_OPEN, number, os.devnull, os.O_RDWR, 0) for number in (0, 1, 2)]
    try:
        os.posix_spawn(words[0], [*words, str(path.resolve())], os.environ, file_actions=nothing)
    except OSError:
        return False
    return True


def _opener() -> list[str] | None:
    """The program that opens a file, with its words."""
    if sys.platform == "darwin":
        return ["/usr/bin/open"]
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return None
    for program, *words in DESKTOP_OPENERS:
        found = shutil.which(program)
        if found is not None:
            return [found, *words]
    return None


def told(path: Path) -> str:
    """Open a picture, and return the sentence that says what was done."""
    if open_picture(path):
        return f"opened {path}"
    return f"no viewer or no display here: the picture is {path.resolve()}"


# Loads the solver, and reports when a solve waits for the compiler.

THREAD_COUNTS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Read by the linear algebra when it is loaded. Its systems are many and small: more threads make it slower."""


def load_solver() -> None:
    """Import the solver, with linear algebra on one thread; raises :class:`NotInstalled` where it is missing."""
    for name in THREAD_COUNTS:
        os.environ.setdefault(name, "1")
    try:
        import scipy  # noqa: F401  # of the extra "solver"

        import equimesh  # noqa: F401
    except ImportError as error:
        raise NotInstalled("solver", error) from error


@contextmanager
def announce_compiling(*, shown: bool = True) -> Iterator[None]:
    """Report on standard error when a loop is compiled inside; with ``shown`` False print nothing."""
    from equimesh.compiling import Line, announcing

    with announcing(Line(plain=True) if shown else None):
        yield
