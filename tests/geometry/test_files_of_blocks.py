"""Meshes of blocks go into files and come back: points, cells and sides to the bit and in their order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from block_cases import changed, data_of, in_blocks, joined_channel, l_shape
from equimesh.io.npz import load_npz
from equimesh.io.reading.read import read_mesh
from equimesh.io.write import Cells, write_mesh
from solver.quality.handmade import wavy

MESHES = {
    "l": l_shape(),
    "turned": in_blocks(wavy()).mesh,
    "channel": joined_channel(),
    "no blocks": changed(l_shape(), blocks=(), block_names=()),
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("suffix", [".msh", ".vtu", ".su2", ".foam.zip", "folder"])
def test_readers_find_the_mesh_that_was_written(tmp_path: Path, suffix: str, name: str) -> None:
    mesh, path = MESHES[name], tmp_path / ("case" if suffix == "folder" else f"mesh{suffix}")
    if suffix == "folder":
        path.mkdir()
    write_mesh(path, data_of(mesh))
    found = read_mesh(path)
    assert np.array_equal(found.points, mesh.points)
    assert np.array_equal(np.sort(found.cells, axis=1), np.sort(mesh.cells, axis=1))
    is_word = suffix in (".msh", ".vtu")
    assert [*found.sides] == [side if is_word else side.replace(" ", "_") for side in mesh.sides]
    for edges, expected in zip(found.sides.values(), mesh.sides.values(), strict=True):
        if suffix in (".foam.zip", "folder") and name == "channel":  # a copy is in the order of its original
            edges, expected = np.unique(edges, axis=0), np.unique(expected, axis=0)
        assert np.array_equal(edges, expected)
    if suffix not in (".foam.zip", "folder"):  # these have faces, and the first corner of a cell is any
        assert np.array_equal(found.cells, mesh.cells)


@pytest.mark.parametrize("name", ["l", "turned", "channel"])
def test_the_grids_of_plot3d_are_the_blocks(tmp_path: Path, name: str) -> None:
    mesh = MESHES[name]
    write_mesh(tmp_path / "mesh.xyz", data_of(mesh))
    found = read_mesh(tmp_path / "mesh.xyz")
    corners = np.concatenate([mesh.points[mesh.cells[cells.ravel()]] for cells in mesh.block_cells])
    there = found.points[found.cells]
    assert len(found.points) == len(mesh.points)
    for k, (one, other) in enumerate(zip(corners.tolist(), there.tolist(), strict=True)):
        assert sorted(one) == sorted(other), k


@pytest.mark.parametrize("kind", ["quad", "triangle"])
@pytest.mark.parametrize("name", MESHES)
def test_npz_files_hold_all_of_it(tmp_path: Path, name: str, kind: Cells) -> None:
    data, path = data_of(MESHES[name]), tmp_path / "mesh.npz"
    write_mesh(path, data, cells=kind)
    found = load_npz(path)
    mesh, expected = found.mesh, data.mesh
    assert not mesh.is_grid
    assert not expected.is_grid
    for array in ("points", "cells", "ties"):
        assert np.array_equal(getattr(mesh, array), getattr(expected, array)), array
    assert [*mesh.sides] == [*expected.sides]
    assert all(np.array_equal(mesh.sides[side], edges) for side, edges in expected.sides.items())
    assert mesh.block_names == expected.block_names
    assert all(np.array_equal(one, two) for one, two in zip(mesh.blocks, expected.blocks, strict=True))
    for array in ("u", "q_eq", "subdomain"):
        assert np.array_equal(getattr(found, array), getattr(data, array)), array
    for one, two in ((found.fields, data.fields), (found.cell_fields, data.cell_fields)):
        assert {*one} == {*two}
        assert all(np.array_equal(one[field], two[field]) for field in two)
