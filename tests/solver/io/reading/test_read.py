"""A mesh from a file: the format by the suffix, and whatever is broken becomes one kind of error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.io.reading.read import READERS, read_bytes, read_mesh
from equimesh.io.solver_files import foam_files, gmsh_text, su2_text
from equimesh.io.vtk import write_vtu
from equimesh.io.write import write_mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.testing import GEOMETRIES
from solver.io.reading.cgns_files import cgns
from solver.io.reading.plain import same, small
from solver.io.reading.test_plot3d import text, two_blocks
from solver.io.reading.test_poly_mesh import zipped


def test_the_format_is_that_of_the_suffix_or_the_named_one(tmp_path: Path) -> None:
    mesh = small()
    text = su2_text(mesh.points, mesh.cells, mesh.sides)
    (tmp_path / "mesh.SU2").write_text(text)
    (tmp_path / "mesh.txt").write_text(text)
    assert same(read_mesh(tmp_path / "mesh.SU2"), mesh)
    assert same(read_mesh(tmp_path / "mesh.txt", "su2"), mesh)
    with pytest.raises(InputError, match=r"the suffix of mesh.txt is of no known format: give one of msh, vtu"):
        read_mesh(tmp_path / "mesh.txt")
    with pytest.raises(InputError, match="choose one of msh, vtu, su2, p3d, cgns, zip"):
        read_bytes(b"", "stl")
    with pytest.raises(InputError, match=r"none.su2 cannot be read"):
        read_mesh(tmp_path / "none.su2")
    with pytest.raises(InputError, match="has no constant/polyMesh"):
        read_mesh(tmp_path)


@pytest.mark.parametrize("suffix", ["msh", "su2", "foam.zip", "p3d.zip"])
@pytest.mark.parametrize("name", ["ring", "disc", "pitz_daily"])
def test_meshes_of_blocks_come_back_to_the_bit(tmp_path: Path, name: str, suffix: str) -> None:
    mesh = GEOMETRIES[name](200).mesh
    data = MeshData(mesh=mesh, u=None, q_eq=np.ones(mesh.cell_shape), subdomain=np.zeros(mesh.cell_shape, int))
    write_mesh(tmp_path / f"mesh.{suffix}", data)
    found = Blocks.read(tmp_path / f"mesh.{suffix}")
    np.testing.assert_array_equal(found.mesh.points, mesh.points)
    np.testing.assert_array_equal(found.mesh.cells, mesh.cells)
    assert found.mesh.sides.keys() == mesh.sides.keys()
    if suffix != "p3d.zip":  # its map has the sides in the order of the blocks
        assert list(found.mesh.sides) == list(mesh.sides)
    for side, edges in mesh.sides.items():
        np.testing.assert_array_equal(found.mesh.sides[side], edges)
    assert [block.tolist() for block in found.mesh.blocks] == [block.tolist() for block in mesh.blocks]


def whole(tmp_path: Path) -> dict[str, bytes]:
    """One file of each format."""
    mesh = small()
    write_vtu(tmp_path / "mesh.vtu", mesh.points, mesh.cells, point_data={}, cell_data={})
    subdomain = np.zeros(6, int)
    msh = gmsh_text(mesh.points, mesh.cells, mesh.sides, subdomain=subdomain, point_data={}, cell_data={})
    return {
        "msh": msh.encode(),
        "vtu": (tmp_path / "mesh.vtu").read_bytes(),
        "su2": su2_text(mesh.points, mesh.cells, mesh.sides).encode(),
        "p3d": text(two_blocks()),
        "cgns": cgns({"zone": (mesh.points.reshape(4, 3, 2), [("left", [[1, 1], [1, 3]], "", "")])}),
        "zip": zipped(foam_files(mesh.points, mesh.cells, mesh.sides)),
    }


@pytest.mark.parametrize("format", READERS)
def test_broken_files_raise_nothing_but_input_errors(tmp_path: Path, format: str) -> None:
    data, random = whole(tmp_path)[format], np.random.default_rng(3)
    refused = 0
    for _ in range(60):
        broken = bytearray(data[: random.integers(1, len(data))] if random.random() < 0.3 else data)
        for _ in range(random.integers(1, 4)):
            place = int(random.integers(len(broken)))
            broken[place : place + int(random.integers(0, 3))] = random.choice(
                [b"9", b"-", b"x", b"1e999", b"nan", b" "]
            )
        try:
            read_bytes(bytes(broken), format)
        except InputError:
            refused += 1
    assert refused > 5


def test_a_zip_has_one_mesh_of_bounded_size(monkeypatch: pytest.MonkeyPatch) -> None:
    packed = zipped({"points": "", "polyMesh/points": ""})
    with pytest.raises(InputError, match="the zip has two files 'points'"):
        read_bytes(packed, "zip")
    monkeypatch.setattr("equimesh.io.reading.bounds.MAX_EXPANDED", 100)
    with pytest.raises(InputError, match="the zip file unpacks to more than the bytes allowed"):
        read_bytes(zipped({"points": "0" * 60, "faces": "0" * 60}), "zip")
