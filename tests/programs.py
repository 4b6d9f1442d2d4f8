"""Programs that tests need and a machine may lack: how each is found, and how to have it."""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

FOR_CONTAINERS = ("podman", "buildah", "debootstrap", "runc", "netavark", "aardvark-dns", "iptables", "podman-compose")
GMSH_LIBRARIES = ("GL", "GLU", "Xcursor", "Xft", "Xinerama", "Xrender", "Xfixes", "Xext", "fontconfig")
# Where Debian installs packages of its Python, and the variable that says that its solvers must be here.
DIST_PACKAGES = Path("/usr/lib/python3/dist-packages")
NEEDED_SOLVERS = "EQUIMESH_TEST_SOLVERS_NEEDED"
# That compilers and interpreters of the clients for other languages must be here.
NEEDED_LANGUAGES = "EQUIMESH_TEST_LANGUAGES_NEEDED"
# The first one draws no window around a page, which halves the processor time of loading one.
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")


@dataclass(frozen=True, kw_only=True)
class Program:
    """A program: how it is called, whether it is here, how to have it, and the variable that says it must be here."""

    name: str
    here: Callable[[], bool]
    remedy: str
    needed: str | None = None


def postgresql_program(name: str) -> str | None:
    """Where a program of PostgreSQL is, if it is here; Debian keeps them out of the path."""
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    return shutil.which(name, path=os.pathsep.join([os.environ["PATH"], *map(str, debian)]))


def browser() -> str | None:
    """Where a browser is, if one is here."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def _one(name: str, needed: str | None = None, package: str | None = None) -> Program:
    return Program(
        name=name,
        here=lambda: shutil.which(name) is not None,
        remedy=f"apt-get install {package or name}",
        needed=needed,
    )


def _of_debian(name: str, place: Path, package: str) -> Program:
    """A library of the system, which is no program in the path."""
    return Program(name=name, here=place.exists, remedy=f"apt-get install {package}", needed=NEEDED_SOLVERS)


def _compiles(code: str) -> bool:
    """Whether the C compiler takes a line of code."""
    done = subprocess.run(["cc", "-E", "-x", "c", "-"], input=code, capture_output=True, text=True)
    return done.returncode == 0


def lacking_for_containers() -> list[str]:
    """What this machine lacks to run containers: rights and programs."""
    folders = [os.environ["PATH"], str(Path(sys.executable).parent), "/usr/lib/podman", "/usr/sbin", "/sbin"]
    programs = [name for name in FOR_CONTAINERS if shutil.which(name, path=os.pathsep.join(folders)) is None]
    return programs if os.getuid() == 0 else ["the rights of root", *programs]


PROGRAMS = {
    "postgresql": Program(
        name="PostgreSQL",
        here=lambda: bool(os.environ.get("EQUIMESH_TEST_POSTGRES")) or postgresql_program("initdb") is not None,
        remedy="apt-get install postgresql, or set EQUIMESH_TEST_POSTGRES to the address of a server",
        needed="EQUIMESH_TEST_POSTGRES_NEEDED",
    ),
    "wrk": _one("wrk", "EQUIMESH_TEST_WRK_NEEDED"),
    "chromium": Program(
        name="Chromium", here=lambda: browser() is not None, remedy="apt-get install chromium-headless-shell"
    ),
    "curl": _one("curl"),
    "cc": Program(
        name="A C compiler with libcurl",
        here=lambda: shutil.which("cc") is not None and _compiles("#include <curl/curl.h>"),
        remedy="apt-get install gcc libc6-dev libcurl4-openssl-dev",
        needed=NEEDED_LANGUAGES,
    ),
    "gfortran": _one("gfortran", NEEDED_LANGUAGES),
    "octave": _one("octave-cli", NEEDED_LANGUAGES, "octave"),
    "julia": Program(
        name="Julia",
        here=lambda: shutil.which("julia") is not None,
        remedy="put the julia of julialang.org on the path",
    ),
    "promtool": _one("promtool", package="prometheus"),
    "containers": Program(
        name="What runs containers",
        here=lambda: not lacking_for_containers(),
        remedy="as root: apt-get install --no-install-recommends podman buildah debootstrap runc netavark aardvark-dns "
        "iptables; pip install podman-compose; here is missing: " + (", ".join(lacking_for_containers()) or "nothing"),
    ),
    "gmsh-libraries": Program(
        name="What the Gmsh of pip loads",
        here=lambda: all(map(ctypes.util.find_library, GMSH_LIBRARIES)),
        remedy="apt-get install libgl1 libglu1-mesa libxcursor1 libxft2 libxinerama1 libxrender1 libxfixes3 libxext6",
        needed="EQUIMESH_TEST_CONSUMERS_NEEDED",
    ),
    "freefem": _one("FreeFem++-nw", NEEDED_SOLVERS, "freefem++ libfreefem++"),
    "openfoam": _one("checkMesh", NEEDED_SOLVERS, "openfoam"),
    "paraview": _one("pvpython", NEEDED_SOLVERS, "paraview python3-paraview"),
    "dolfinx": _of_debian("dolfinx", DIST_PACKAGES / "dolfinx.pth", "python3-dolfinx python3-gmsh"),
    "petsc4py": _of_debian("petsc4py", DIST_PACKAGES / "petsc4py.pth", "python3-petsc4py"),
    "deal.II": _of_debian("deal.II", Path("/usr/include/deal.II"), "libdeal.ii-dev cmake g++"),
    "systemd-analyze": _one("systemd-analyze", package="systemd"),
}


def programs_of(item: pytest.Item) -> set[str]:
    """The programs that a test needs: those of its marks, and PostgreSQL where a fixture gives a database on it."""
    names = {name for mark in item.iter_markers("needs") for name in mark.args}
    values = getattr(item, "callspec").params.values() if hasattr(item, "callspec") else ()  # noqa: B009
    on_postgresql = any(isinstance(value, str) and value == "postgresql" for value in values)
    if on_postgresql or "postgres" in getattr(item, "fixturenames", ()):
        names.add("postgresql")
    return names


def missing_program(item: pytest.Item) -> str | None:
    """The first program that a test needs and this machine lacks, if there is one."""
    return next((name for name in sorted(programs_of(item)) if not PROGRAMS[name].here()), None)


def must_be_here(name: str) -> bool:
    """Whether tests that need this program fail without it."""
    needed = PROGRAMS[name].needed
    return needed is not None and bool(os.environ.get(needed))
