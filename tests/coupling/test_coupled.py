"""The methods that hand a mesh over: their libraries missing, too old, and imported only when called."""

from __future__ import annotations

import subprocess
import sys
from importlib import metadata
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from equimesh import Mesh
from equimesh_coupling import Coupled, MissingLibrary, OldLibrary

# By the name of a method: the module that it imports, the package of its version, and how the package is installed.
LIBRARIES = {
    "skfem": ("skfem", "scikit-fem", "pip install 'scikit-fem>=9'"),
    "pyvista": ("pyvista", "pyvista", "pip install 'pyvista>=0.40'"),
    "fipy": ("fipy", "fipy", "pip install 'fipy>=3.4.5'"),
    "mfem": ("mfem.ser", "mfem", "pip install 'mfem>=4.7'"),
    "ngsolve": ("ngsolve", "ngsolve", "pip install 'ngsolve>=6.2.2302'"),
    "sfepy": ("sfepy.discrete.fem", "sfepy", "pip install 'sfepy>=2021.1'"),
    "dolfinx": ("dolfinx", "fenics-dolfinx", "apt-get install python3-dolfinx"),
    "dmplex": ("petsc4py.PETSc", "petsc4py", "apt-get install python3-petsc4py"),
}


def hand_over(mesh: Coupled, name: str) -> Any:
    """Call a method, where it takes one with a communicator of one process."""
    method = getattr(mesh, f"to_{name}")
    return method(SimpleNamespace(rank=0, size=1)) if name in ("dolfinx", "dmplex") else method()


def test_every_library_is_here() -> None:
    assert {name.removeprefix("to_") for name in vars(Coupled) if name.startswith("to_")} == {*LIBRARIES}


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_missing_library_is_named_with_its_package(name: str, mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    module, package, install = LIBRARIES[name]
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingLibrary) as caught:
        hand_over(mesh, name)
    assert str(caught.value).startswith(f"this needs {package}, which is not installed: {install}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", LIBRARIES)
def test_an_old_library_is_named_with_both_versions(name: str, mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    module, package, install = LIBRARIES[name]
    for part in (module.partition(".")[0], module):
        monkeypatch.setitem(sys.modules, part, ModuleType(part))
    monkeypatch.setattr(metadata, "version", {package: "0.1", "dolfinx": "0.1"}.__getitem__)
    with pytest.raises(OldLibrary) as caught:
        hand_over(mesh, name)
    assert str(caught.value).startswith(f"this needs {package} ")
    assert f" or later, and 0.1 is installed: {install}" in str(caught.value)


def test_nothing_is_imported_before_it_is_needed() -> None:
    roots = ["scipy", "meshio", "netgen", "ufl", *(module.partition(".")[0] for module, _, _ in LIBRARIES.values())]
    code = f"import sys, equimesh_coupling; print([name for name in {roots!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "[]\n"
