"""Meshes from VTK's files of several blocks."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from block_cases import data_of
from equimesh.blocks.blocks import Blocks
from equimesh.io.reading.plain_mesh import PlainMesh
from equimesh.io.reading.read import read_bytes, read_mesh
from equimesh.io.write import write_mesh
from equimesh.testing import GEOMETRIES


@pytest.mark.parametrize("suffix", [".vtm", ".vtm.zip"])
@pytest.mark.parametrize("name", ["l_shape", "disc", "pitz_daily"])
def test_blocks_come_back_to_the_bit_with_their_names(tmp_path: Path, name: str, suffix: str) -> None:
    mesh = GEOMETRIES[name](150).mesh
    write_mesh(tmp_path / f"mesh{suffix}", data_of(mesh))
    found = Blocks.read(tmp_path / f"mesh{suffix}").mesh
    np.testing.assert_array_equal(found.points, mesh.points)
    np.testing.assert_array_equal(found.cells, mesh.cells)
    assert found.block_names == mesh.block_names


def test_two_pieces_of_one_block_have_two_names() -> None:
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1], [0, 2], [1, 2]])
    cells = np.array([[0, 1, 4, 3], [1, 2, 5, 4], [3, 4, 7, 6]])
    plain = PlainMesh(points=points, cells=cells, blocks=(("low", 2), ("high", 1)))
    assert Blocks.of_plain(plain).mesh.block_names == ("low", "low_2", "high")


def test_what_is_wrong_is_named(tmp_path: Path) -> None:
    write_mesh(tmp_path / "mesh.vtm", data_of(GEOMETRIES["l_shape"](60).mesh))
    head, grid = tmp_path / "mesh.vtm", tmp_path / "mesh_1.vts"
    text, block = head.read_text(), grid.read_bytes()
    for broken, message in [
        (
            text.replace("mesh_1.vts", "../mesh_1.vts"),
            r"block 1 of the vtm file is in '../mesh_1.vts': its file",
        ),
        (
            text.replace("mesh_1.vts", "mesh_0.vts"),
            "two blocks of the vtm file are in 'mesh_0.vts': name each file once",
        ),
        (text.replace("mesh_1.vts", "none.vts"), "none.vts cannot be read: No such file"),
        (text.replace("MultiBlock", "Other"), "3 blocks: a vtkMultiBlockDataSet of 1 to"),
        (text.replace("<DataSet", "<Other"), "the vtm file has 0 blocks"),
        (text[:60], "the vtm file cannot be read"),
    ]:
        head.write_text(broken)
        with pytest.raises(em.InputError, match=message):
            read_mesh(head)
    head.write_text(text)
    for bad, message in [
        (block[:900], r"'mesh_1.vts' of the vtm file cannot be read: "),
        (block.replace(b"Extent=", b"Extend="), "'mesh_1.vts' of the vtm file cannot be read: 'Extent'"),
        (block.replace(b' 0 0"', b' 0 1"'), "x 2 nodes: a plane grid has at least 2 x 2 x 1"),
        (block.replace(b"StructuredGrid", b"RectilinearGrid"), "it has 0 pieces of a structured grid with points"),
    ]:
        assert bad != block
        grid.write_bytes(bad)
        with pytest.raises(em.InputError, match=message):
            read_mesh(head)


def test_a_zip_has_the_grids_that_its_head_names(tmp_path: Path) -> None:
    path = tmp_path / "mesh.vtm.zip"
    write_mesh(path, data_of(GEOMETRIES["l_shape"](60).mesh))
    with zipfile.ZipFile(path) as packed, zipfile.ZipFile(tmp_path / "less.zip", "w") as less:
        for name in packed.namelist():
            if name != "mesh_2.vts":
                less.writestr(f"folder/{name}", packed.read(name))
    with pytest.raises(em.InputError, match=r"the zip has no file 'mesh_2.vts', which its vtm file names: pack it"):
        read_bytes((tmp_path / "less.zip").read_bytes(), "zip")
