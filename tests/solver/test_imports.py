"""What ``import equimesh`` does not load: the solver itself, and libraries that only some problems and files need."""

from __future__ import annotations

import subprocess
import sys

import equimesh

LOADED = """
import sys
import equimesh
for name in {names}:
    getattr(equimesh, name)
print(*sorted({{".".join(name.split(".")[:2]) for name in sys.modules}}))
"""
# Together they take longer to load than all that the solver needs.
LATER = {"h5py", "matplotlib", "meshio"} | {
    f"scipy.{part}" for part in ("fft", "interpolate", "linalg", "ndimage", "optimize", "sparse", "spatial", "special")
}


def loaded(*names: str) -> set[str]:
    """The modules that are loaded by the import and by the use of these names."""
    code = LOADED.format(names=names)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_large_libraries_are_loaded_when_they_are_needed() -> None:
    found = loaded(*equimesh.__all__)
    assert "equimesh.numerics" in found
    assert found & LATER == set()


def test_the_import_alone_loads_no_solver() -> None:
    found = loaded("InputError", "Relaxed")
    assert {"equimesh", "equimesh_schema"} <= found
    assert {name for name in found if name.partition(".")[0] in {"numba", "llvmlite", "scipy"}} == set()


def test_names_are_those_of_their_modules_and_packages_hide_none() -> None:
    from equimesh.adaptation import loop
    from equimesh.schwarz.iteration import schwarz_iterations

    assert equimesh.adapt is loop.adapt
    assert equimesh.iterate is schwarz_iterations
    assert equimesh.quality.measure is equimesh.measure
    assert not hasattr(equimesh, "nothing")
