"""The errors of coupling, and imports when something is used, and never before.

::

    EquimeshError             the root of the solver, and of the client under the name EquimeshClientError
    ├── InputError            an argument that cannot be used; the message names the place and a remedy
    └── CouplingError         a mesh does not reach another library, or values do not come back
        ├── MissingLibrary    the library is not installed, or does not load (also an ImportError)
        ├── OldLibrary        the library is older than what the adaptor needs (also an ImportError)
        └── BadValues         what a solver returned cannot be used on the mesh (also a ValueError)
"""

from __future__ import annotations

import ast
import importlib
import re
import sys
import threading
from functools import cache
from importlib import metadata
from typing import Any

PARSING = threading.RLock()
"""Held while a syntax tree is built: threads of Python 3.11 share a count of depth, and may end in a SystemError."""


class EquimeshError(Exception):
    """Root of every exception that equimesh raises on purpose."""


class InputError(EquimeshError, ValueError):
    """Input that cannot be used.

    ``field`` names the offending option as a path of the problem's own names, e.g. ``"grid.n_xi"`` or
    ``"a"``; the message describes the fault and the remedy.
    """

    def __init__(self, message: str, *, field: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.field = field


class CouplingError(EquimeshError):
    """A mesh that does not reach another library, or values that do not come back."""


class MissingLibrary(CouplingError, ImportError):
    """A library that is not installed, or that does not load; the message names its package."""


class OldLibrary(CouplingError, ImportError):
    """A library that is older than what the adaptor needs; the message names both versions."""


class BadValues(CouplingError, ValueError):
    """Values of a solver that cannot be used: another length, not finite, or cell averages in place of nodal ones."""


def library(module: str, *, install: str, package: str = "", at_least: str = "") -> Any:
    """The imported ``module`` of a library.

    ``install`` is the command that installs it, ``package`` the name under which its version is known, ``at_least`` the
    oldest version that has what the adaptor uses. Raises :class:`MissingLibrary` where the import fails, and
    :class:`OldLibrary` for an older version.
    """
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        missing = isinstance(error, ModuleNotFoundError) and (error.name or name).partition(".")[0] == name
        fault = "is not installed" if missing else f"does not load ({error})"
        raise MissingLibrary(f"this needs {package or name}, which {fault}: {install}", name=module) from error
    version = _version(package or module)
    if at_least and version and _numbers(version) < _numbers(at_least):
        raise OldLibrary(
            f"this needs {package or module} {at_least} or later, and {version} is installed: {install}", name=module
        )
    return found


def deferred(package: str, name: str) -> Any:
    """A public name of a package that is not imported yet: of the module from which a type checker imports it.

    The package has its imports under ``if TYPE_CHECKING``. Raises AttributeError for a name that is not there.
    """
    home = None if name.startswith("__") else _homes(package).get(name)
    if home is None:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    found = getattr(importlib.import_module(home[0]), home[1])
    setattr(sys.modules[package], name, found)  # the next use finds it there
    return found


@cache
def _homes(package: str) -> dict[str, tuple[str, str]]:
    """The module and the name there of each name that a package imports for type checkers alone."""
    loader: Any = sys.modules[package].__loader__
    with PARSING:
        tree = ast.parse(loader.get_source(package))
    blocks = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    imports = [line for block in blocks for line in block.body if isinstance(line, ast.ImportFrom)]
    return {alias.asname or alias.name: (line.module or "", alias.name) for line in imports for alias in line.names}


def _version(package: str) -> str:
    """The installed version of a package; empty where its installer left none."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _numbers(version: str) -> tuple[int, ...]:
    """The leading numbers of a version: (4, 0, 3) of 4.0.3rc1."""
    found = re.match(r"\d+(?:\.\d+)*", version)
    return tuple(map(int, found.group().split("."))) if found else ()
