"""Multi-block files: a head and a structured grid for each block."""

from __future__ import annotations

import io
import re
import struct
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import meshio
import numpy as np
import pytest

from block_cases import changed, data_of, l_shape
from equimesh.errors import InputError
from equimesh.io.reading.vtk import VtkXml
from equimesh.io.vtk import vtm_text, write_vtu
from equimesh.io.write import Cells, write_mesh
from equimesh.upload.samples import read_samples
from solver.io.files import CELL_COUNT, DATA, KINDS, N_ETA, N_XI, check_mesh, written
from solver.upload.bombs import check_bomb_is_refused
from solver.upload.files import TABLE, X, Y, npy, npz, refused


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
    unknown = data_of(changed(l_shape(), blocks=(), block_names=()))
    with pytest.raises(InputError, match="the blocks of this mesh are not known: choose a format without blocks"):
        write_mesh(tmp_path / "mesh.vtm", unknown)
    with pytest.raises(InputError, match="a vts file holds one grid, not blocks: choose vtm or vtu"):
        write_mesh(tmp_path / "mesh.vts", data_of(l_shape()))
    with pytest.raises(InputError, match="a p3d file holds no triangles"):
        write_mesh(tmp_path / "mesh.xyz", DATA, cells="triangle")


# VTU files, read back by meshio and by our own reader of points.


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


# Members of zip files: damaged ones, and files that would take far more memory or time than their bytes.


def test_npz_that_is_none() -> None:
    refused(b"PK nonsense", "u.npz", "cannot be unpacked", "numpy.savez")
    refused(npz(x=X, y=Y, values=TABLE)[:-40], "u.npz", "cannot be unpacked")
    refused(npy(TABLE), "u.npz", "cannot be unpacked")


def test_every_member_of_a_zip_is_bounded_together() -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("x", "y", "values"):
            archive.writestr(f"{name}.npy", npy(np.zeros(50_000)))
    refused(stream.getvalue(), "u.npz", "unpacks to more than", max_bytes=900_000)


ZEROS = bytes(20_000_000)


def npy_header(header: str, version: int = 1) -> bytes:
    """An npy file that holds a header, and nothing else."""
    length = len(header).to_bytes(2 if version == 1 else 4, "little")
    return b"\x93NUMPY" + bytes([version, 0]) + length + header.encode()


def shaped(shape: str) -> bytes:
    """An npy file that claims a shape."""
    return npy_header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}\n")


def objects() -> bytes:
    """An npy file of Python objects, which would be unpickled."""
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    return stream.getvalue()


def zipped_as_npz(
    content: bytes, method: int = zipfile.ZIP_DEFLATED, *, claimed: int | None = None, more: int = 0
) -> bytes:
    """A zip file like an npz; ``claimed`` is what it says of the size of the first member."""
    stream, axis = io.BytesIO(), io.BytesIO()
    np.save(axis, np.linspace(0.0, 1.0, 3))
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("values.npy", content, compress_type=method)
        for name in ("x.npy", "y.npy", *(f"m{k}.npy" for k in range(more))):
            archive.writestr(name, axis.getvalue())
    data = stream.getvalue()
    return data if claimed is None else data.replace(struct.pack("<I", len(content)), struct.pack("<I", claimed))


BOMBS = {
    "one that says so": ("u.npz", lambda: zipped_as_npz(ZEROS), "unpacks to more than"),
    "one that says it is small": ("u.npz", lambda: zipped_as_npz(ZEROS, claimed=1000), "cannot be unpacked"),
    "one of another packing": ("u.npz", lambda: zipped_as_npz(ZEROS, zipfile.ZIP_BZIP2, claimed=1000), "use deflate"),
    "one of another packing still": (
        "u.npz",
        lambda: zipped_as_npz(ZEROS, zipfile.ZIP_LZMA, claimed=1000),
        "use deflate",
    ),
    "one inside another": ("u.npz", lambda: zipped_as_npz(zipped_as_npz(ZEROS)), "not a plain npy array"),
    "very many members": ("u.npz", lambda: zipped_as_npz(b"", more=20_000), "more than 1000 members"),
    "objects": ("u.npz", lambda: zipped_as_npz(objects()), "only real numbers"),
    "objects alone": ("u.npy", lambda: objects(), "only real numbers"),
    "a huge shape": ("u.npy", lambda: shaped("(1000000000, 1000000000)"), "has 0 bytes"),
    "a shape of many digits": ("u.npy", lambda: shaped(f"({'9' * 90},)"), "has 0 bytes"),
    "a huge shape of no number": ("u.npy", lambda: shaped(f"(0, {'9' * 60})"), "has 0 bytes"),
    "many dimensions": ("u.npy", lambda: shaped(f"({'0,' * 45})"), "has 0 bytes"),
    "a huge header": ("u.npy", lambda: b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b"x" * 100, "not a plain npy array"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused(name: str) -> None:
    filename, pack, match = BOMBS[name]
    check_bomb_is_refused(pack(), filename, match)
