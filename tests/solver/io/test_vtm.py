"""Multi-block files: a head and a structured grid for each block."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from block_cases import data_of, l_shape
from equimesh.errors import InputError
from equimesh.io.reading.vtk import VtkXml
from equimesh.io.vtk import vtm_text
from equimesh.io.write import write_mesh
from solver.io.files import DATA


def test_the_head_names_its_blocks() -> None:
    root = ET.fromstring(vtm_text([("low & high", "mesh_0.vts"), ("right", "mesh_1.vts")]))
    assert root.get("type") == "vtkMultiBlockDataSet"
    rows = [(row.get("index"), row.get("name"), row.get("file")) for row in root.iter("DataSet")]
    assert rows == [("0", "low & high", "mesh_0.vts"), ("1", "right", "mesh_1.vts")]


def test_every_block_has_its_nodes_and_values(tmp_path: Path) -> None:
    data = data_of(l_shape())
    files = write_mesh(tmp_path / "mesh.vtm", data)
    assert [file.name for file in files] == ["mesh.vtm", "mesh_0.vts", "mesh_1.vts", "mesh_2.vts"]
    for block, cells, file in zip(data.mesh.blocks, data.mesh.block_cells, files[1:], strict=True):
        reader = VtkXml(file.read_bytes(), 1 << 20)
        arrays = {array.get("Name"): array for array in reader.root.iter("DataArray")}
        points = reader.array(arrays["Points"], 75).reshape(5, 5, 3).swapaxes(0, 1)
        assert np.array_equal(points[..., :2], data.mesh.points[block])
        assert np.array_equal(reader.array(arrays["u"], 25).reshape(5, 5).T, data.u[block])
        assert np.array_equal(reader.array(arrays["Q_eq"], 16).reshape(4, 4).T, data.q_eq[cells])
        assert np.array_equal(
            reader.array(arrays["way"], 48).reshape(4, 4, 3)[..., 1].T, data.cell_fields["mean"][cells]
        )


def test_a_grid_is_one_block_and_unknown_blocks_are_refused(tmp_path: Path) -> None:
    write_mesh(tmp_path / "mesh.vtm.zip", DATA)
    with zipfile.ZipFile(tmp_path / "mesh.vtm.zip") as archive:
        assert archive.namelist() == ["mesh.vtm", "mesh_0.vts"]
    unknown = data_of(replace(l_shape(), blocks=(), block_names=()))
    with pytest.raises(InputError, match="the blocks of this mesh are not known: choose a format without blocks"):
        write_mesh(tmp_path / "mesh.vtm", unknown)
    with pytest.raises(InputError, match="a vts file holds one grid, not blocks: choose vtm or vtu"):
        write_mesh(tmp_path / "mesh.vts", data_of(l_shape()))
    with pytest.raises(InputError, match="a p3d file holds no triangles"):
        write_mesh(tmp_path / "mesh.xyz", DATA, cells="triangle")
