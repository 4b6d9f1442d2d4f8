"""Plot3D grids and their neutral map files, and what VTK's rules say of them."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np

from block_cases import data_of, in_blocks, l_shape
from equimesh.io.solver_files import neutral_map, plot3d_text
from equimesh.io.write import write_mesh
from equimesh.meshes.interfaces import contacts
from solver.io.files import DATA
from solver.quality.handmade import wavy


def test_the_grid_has_its_blocks_one_after_the_other_with_i_first() -> None:
    x, y = np.meshgrid([0.0, 1.0, 2.5], [0.0, 0.1], indexing="ij")
    text = plot3d_text([(x, y), (x + 5, y)])
    assert text.splitlines()[:3] == ["2", "3 2 1", "3 2 1"]
    numbers = np.array(text.split()[7:], dtype=float).reshape(2, 3, 2, 3)
    assert numbers[0, 0].tolist() == [[0.0, 1.0, 2.5], [0.0, 1.0, 2.5]]
    assert numbers[1, 1].tolist() == [[0.0] * 3, [0.1] * 3]
    assert not numbers[:, 2].any()


def test_the_map_names_the_faces_of_interfaces_and_sides() -> None:
    mesh = l_shape(3)
    rows = neutral_map([(3, 3)] * 3, contacts(mesh)).splitlines()
    assert rows[1:5] == ["3", "1 3 3 1", "2 3 3 1", "3 3 3 1"]
    assert "'ONE_TO_ONE' 1 4 1 3 1 1 2 3 1 3 1 1 FALSE" in rows
    assert "'ONE_TO_ONE' 1 6 1 1 1 3 3 5 1 1 1 3 FALSE" in rows
    assert "'outlet' 2 4 1 3 1 1" in rows


def test_the_ranges_of_a_turned_block_fall_and_are_swapped() -> None:
    mesh = in_blocks(wavy(), column=3).mesh
    (row,) = [row for row in neutral_map([(4, 9), (9, 10)], contacts(mesh)).splitlines() if "ONE" in row]
    found = re.fullmatch(r"'ONE_TO_ONE' 1 4 1 9 1 1 2 ([56]) 1 1 (\d) (\d) TRUE", row)
    assert found
    first, last = int(found[2]), int(found[3])
    there = {"5": mesh.blocks[1][:, 0], "6": mesh.blocks[1][:, -1]}[found[1]]
    assert np.array_equal(there[:: 1 if last > first else -1], mesh.blocks[0][-1])


def test_files_of_blocks_and_of_a_grid(tmp_path: Path) -> None:
    assert write_mesh(tmp_path / "mesh.p3d", data_of(l_shape())) == (tmp_path / "mesh.p3d", tmp_path / "mesh.nmf")
    assert write_mesh(tmp_path / "mesh.p3d.zip", DATA) == (tmp_path / "mesh.p3d.zip",)
    with zipfile.ZipFile(tmp_path / "mesh.p3d.zip") as archive:
        assert archive.namelist() == ["mesh.xyz", "mesh.nmf"]
        assert archive.read("mesh.xyz").split()[:4] == [b"1", b"7", b"5", b"1"]
        assert b"'left' 1 3 1 5 1 1" in archive.read("mesh.nmf")
