"""What ``import equimesh`` does not load: libraries that only some problems and files need."""

from __future__ import annotations

import subprocess
import sys

LOADED = """
import sys
import equimesh
print(*sorted({".".join(name.split(".")[:2]) for name in sys.modules}))
"""
# Together they take longer to load than all that the import needs.
LATER = {"h5py", "matplotlib", "meshio"} | {
    f"scipy.{part}" for part in ("fft", "interpolate", "linalg", "ndimage", "optimize", "sparse", "spatial", "special")
}


def test_large_libraries_are_loaded_when_they_are_needed() -> None:
    done = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert "equimesh.numerics" in loaded
    assert loaded & LATER == set()
