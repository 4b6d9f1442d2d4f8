"""Checks of what is installed: Python, packages, settings, compiled loops, and the mesh of the paper."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import tempfile
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from equimesh_cli.checks.findings import Finding, failed, ok, warning

if TYPE_CHECKING:
    from packaging.requirements import Requirement

    from equimesh_service.settings import Settings

# The largest q_eq of a single domain in Table 1 of Haynes and Howse, as it is printed.
TABLE_1 = "1.1979"
# Measured: 59 s of processor time for all loops.
COMPILING = "about a minute of processor time"


def variables(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether every EQUIMESH_ variable is a setting."""
    from equimesh_service.settings import describe_unknown, find_unknown

    foreign = find_unknown(os.environ)
    if foreign:
        message = "; ".join(describe_unknown(name, nearest) for name, nearest in foreign.items())
        return warning(message, "correct or unset misspelled variables; `equimesh config` shows the settings")
    return ok("every EQUIMESH_ variable is a setting")


def python(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether the package supports this Python."""
    from packaging.specifiers import SpecifierSet

    wanted = importlib.metadata.metadata("equimesh")["Requires-Python"]
    here = platform.python_version()
    if not SpecifierSet(wanted).contains(here, prereleases=True):
        return failed(f"this is Python {here}; equimesh needs {wanted}", "install equimesh with such a Python")
    return ok(f"{here} (needs {wanted})")


def packages(settings: Settings) -> Finding:
    """Whether all packages that the settings need are installed, in the required versions."""
    extras = ["service"]
    if settings.database.startswith("postgres"):
        extras.append("postgres")
    if settings.files_url.startswith("s3:"):
        extras.append("s3")
    if settings.engine == "dask":
        extras.append("dask")
    if settings.trace_endpoint:
        extras.append("tracing")
    wanted = {str(requirement): requirement for extra in extras for requirement in _requirements(extra)}
    wrong = sorted(filter(None, map(_fault, wanted.values())))
    if wrong:
        return failed("; ".join(wrong), f"pip install 'equimesh[{','.join(extras)}]'")
    version = importlib.metadata.version("equimesh")
    return ok(f"equimesh {version} with {', '.join(extras)}: {len(wanted)} packages in the required versions")


def kernels(settings: Settings) -> Finding:  # noqa: ARG001
    """How many of the loops are compiled, and whether their machine code can be stored."""
    import equimesh  # noqa: F401  # has all loops
    from equimesh.numerics.compiled import cache_folder, count_compiled

    compiled, of = count_compiled()
    folder = cache_folder()
    try:
        if folder is None:
            raise OSError("Numba finds no folder")
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return warning(
            f"there is no folder for compiled loops: every start compiles all {of}, {COMPILING}",
            "set NUMBA_CACHE_DIR to a folder that the service may write",
        )
    found = f"{compiled} of {of} numerical loops are compiled, and stored in {folder} and folders like it"
    return ok(
        found if compiled == of else f"{found}; the first start compiles the others: all of them take {COMPILING}"
    )


def solve(settings: Settings) -> Finding:  # noqa: ARG001
    """Whether the mesh of the paper has the printed quality."""
    import equimesh as em
    from equimesh_cli.compiling import announce_compiling

    u = em.Expression("(1-exp(15*(x-1)))*sin(pi*y)")
    grid = em.Grid(n_xi=12, n_eta=12)
    problem = em.Problem(monitor=em.ArcLength(u=u, a=0.7, b=0.05), grid=grid, boundary=em.Boundary.EQUIDISTRIBUTED_1D)
    began = time.perf_counter()
    with announce_compiling():
        solution = em.solve(problem, initial=em.Initial.UNIFORM)
    took = time.perf_counter() - began
    found = f"{solution.quality.q_eq.max:.4f}"
    if found != TABLE_1:
        return failed(
            f"the mesh of Table 1 has the quality {found}; the paper prints {TABLE_1}",
            "install the versions of constraints.txt, and empty the folder of compiled loops",
        )
    return ok(f"the mesh of Table 1 has the printed quality, q_eq {found}; solved in {took:.2g} s")


def _requirements(extra: str) -> Iterator[Requirement]:
    """The requirements of an extra and of the extras that it names."""
    from packaging.requirements import Requirement

    for text in importlib.metadata.requires("equimesh") or []:
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": extra}):
            continue
        if requirement.name == "equimesh":
            for further in sorted(requirement.extras):
                yield from _requirements(further)
        else:
            requirement.marker = None
            yield requirement


def _fault(requirement: Requirement) -> str | None:
    try:
        here = importlib.metadata.version(requirement.name)
    except importlib.metadata.PackageNotFoundError:
        return f"{requirement.name} is not installed"
    if not requirement.specifier.contains(here, prereleases=True):
        return f"{requirement.name} is {here}; {requirement.specifier} is needed"
    return None
