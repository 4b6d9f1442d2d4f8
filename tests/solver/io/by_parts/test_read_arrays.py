"""Rows of HDF5 and zarr: the files stay closed between reads."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from equimesh.io.by_parts.read_arrays import Chunks, Datasets, FlatDatasets
from solver.io.by_parts.parted import ARRAYS, CUTS, written

KINDS = {"xdmf": Datasets, "vtkhdf": FlatDatasets, "zarr": Chunks}


@pytest.mark.parametrize("name", KINDS)
def test_rows_are_read_by_a_copy_in_another_process(tmp_path: Path, name: str) -> None:
    head = written(tmp_path, name, CUTS[1])
    rows = KINDS[name].of(head.with_suffix(".h5") if name == "xdmf" else head)
    copy = pickle.loads(pickle.dumps(rows))
    np.testing.assert_array_equal(copy.rows("y", 40, 42), ARRAYS["y"][40:42])
    assert copy.parted.cuts == CUTS[1]
