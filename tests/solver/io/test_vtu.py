"""VTU files, read back by meshio and by our own reader of points."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np
import pytest

from equimesh.io.vtk import write_vtu
from equimesh.io.write import Cells
from equimesh.upload.samples import read_samples
from solver.io.files import CELL_COUNT, DATA, KINDS, N_ETA, N_XI, check_mesh, written


@pytest.mark.parametrize("kind", KINDS)
def test_vtu(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "vtu", kind)
    check_mesh(meshio.vtu.read(path), kind, dimension=3)
    text = path.read_text()
    count = CELL_COUNT * (2 if kind == "triangle" else 1)
    assert f'NumberOfPoints="{N_XI * N_ETA}" NumberOfCells="{count}"' in text
    assert 'type="UnstructuredGrid"' in text
    assert re.findall(r'type="(\w+)" Name="(?:connectivity|offsets|types)"', text) == ["Int32", "Int32", "UInt8"]
    again = read_samples(path.read_bytes(), "mesh.vtu")  # our own reader of points
    np.testing.assert_array_equal(again.values, DATA.u.ravel())


@pytest.mark.parametrize("kind", KINDS)
def test_vtu_in_pieces(tmp_path: Path, kind: Cells, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file is the same however many pieces it is written in, and whatever the last one's size."""
    whole = written(tmp_path, "vtu", kind).read_bytes()
    monkeypatch.setattr("equimesh.io.vtk.PIECE", 33)
    assert written(tmp_path, "vtu", kind).read_bytes() == whole
    values = {f"<{n}>": np.arange(n, dtype=">f8") for n in range(1, 9)}
    for name, array in values.items():
        points, cells = np.zeros((array.size, 2)), np.zeros((1, 4), dtype=np.int64)
        write_vtu(tmp_path / "small.vtu", points, cells, point_data={name: array}, cell_data={})
        found = meshio.vtu.read(tmp_path / "small.vtu").point_data
        assert {key: value.tolist() for key, value in found.items()} == {name: array.tolist()}
