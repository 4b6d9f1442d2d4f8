"""What the package imports: names of files without Dask, and a remedy where Dask is missing."""

from __future__ import annotations

import subprocess
import sys

import pytest

import equimesh_cluster

WITHOUT_DASK = """
import sys
sys.modules["distributed"] = None
import equimesh_cluster
assert equimesh_cluster.read_parts and "dask" not in sys.modules
try:
    equimesh_cluster.solve
except ImportError as error:
    print(error)
"""


def test_files_need_no_dask_and_the_other_names_say_how_to_install_it() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_DASK], capture_output=True, text=True, timeout=120)
    assert done.stdout == "this needs distributed, which is not installed: pip install 'equimesh[dask]'\n", done.stderr


def test_all_names_are_there() -> None:
    for name in equimesh_cluster.__all__:
        assert getattr(equimesh_cluster, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'solves'"):
        _ = equimesh_cluster.solves
