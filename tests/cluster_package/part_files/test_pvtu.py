"""Each format of meshes in parts: its bytes, its cells, and its numbers in the whole mesh."""

from __future__ import annotations

import mmap
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import dask.array as da
import h5py
import numpy as np
import pytest
import zarr

from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, N_ETA, N_XI, data_of, parts_of, subdomains, written
from equimesh.errors import InputError, SamplesError
from equimesh.io.reading.vtk import VtkXml
from equimesh.io.write import node_groups
from equimesh_cluster import write_head, write_part
from equimesh_cluster.part_files import zarr_parts
from equimesh_cluster.part_files.pvtu import Piece, Pieces, RawArray, described, head_text, vtk_type, write_raw
from equimesh_cluster.part_files.vtkhdf import Source, add_virtual, create
from equimesh_cluster.part_files.zarr_parts import CHUNK_ROWS, unfinished

A, B = np.arange(6.0), np.array([[1, 2, 3]], dtype=np.int32)


def arrays() -> dict[str, list[RawArray]]:
    first = RawArray(name="a", dtype=np.float64, count=6, blocks=lambda: iter([A[:4], A[4:]]))
    second = RawArray(name="b", dtype=np.int32, count=3, components=3, blocks=lambda: iter([B]))
    return {"PointData": [first], "CellData": [second]}


def test_bytes_follow_their_count(tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    write_raw(path, 'NumberOfPoints="6"', arrays(), "")
    text, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">\n_')
    found = {array.attrib["Name"]: array.attrib for array in ET.fromstring(text + b"</VTKFile>").iter("DataArray")}
    assert (found["a"]["type"], found["a"]["offset"], found["b"]["type"]) == ("Float64", "0", "Int32")
    assert found["b"]["NumberOfComponents"] == "3"
    for name, values in (("a", A), ("b", B)):
        start = int(found[name]["offset"])
        assert int.from_bytes(data[start : start + 8], "little") == values.nbytes
        assert data[start + 8 : start + 8 + values.nbytes] == values.tobytes()
    assert data.endswith(b"\n</AppendedData>\n</VTKFile>\n")


def test_blocks_that_do_not_add_up_are_refused(tmp_path: Path) -> None:
    short = RawArray(name="a", dtype=np.float64, count=7, blocks=lambda: iter([A]))
    with pytest.raises(ValueError, match="a has 48 bytes, not 56"):
        write_raw(tmp_path / "a.vtu", "", {"PointData": [short]}, "")


def test_a_head_is_xml() -> None:
    names = [described("u", np.float64), described("GlobalNodeIds", np.int64)]
    root = ET.fromstring(head_text({"PPointData": names}, ['<Piece Source="a"/>']))
    section = root.find("PUnstructuredGrid/PPointData")
    assert section.attrib == {"GlobalIds": "GlobalNodeIds"}
    assert vtk_type(np.uint8) == "UInt8"


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_cells_join_to_the_whole_mesh(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    written(tmp_path, "pvtu", cuts)
    found = []
    for part in parts_of(cuts):
        piece = Piece(path=tmp_path / "mesh" / f"part-000{part.number}.vtu")
        count = len(part.cells)
        (attributes,) = (element.attrib for element in VtkXml.mapped(piece.path).root.iterfind(".//Piece"))
        assert attributes == {"NumberOfPoints": str(part.x.size), "NumberOfCells": str(count)}
        ids = piece.array("PointData", "GlobalNodeIds", (part.x.size,))
        cells = piece.array("Cells", "connectivity", (count, 4))
        np.testing.assert_array_equal(cells, part.cells)
        np.testing.assert_array_equal(piece.array("Cells", "offsets", (count,)), 4 * np.arange(1, count + 1))
        assert np.all(piece.array("Cells", "types", (count,)) == 9)
        np.testing.assert_array_equal(piece.array("Points", "Points", (part.x.size, 3))[:, :2], DATA.mesh.points[ids])
        np.testing.assert_array_equal(piece.array("PointData", "node_groups", ids.shape), node_groups(DATA)[ids])
        found.append(ids[cells])
    np.testing.assert_array_equal(np.concatenate(found), DATA.mesh.cells)


def test_arrays_are_mapped_and_named(tmp_path: Path) -> None:
    written(tmp_path, "pvtu", CUTS[1])
    piece = Piece(path=tmp_path / "mesh" / "part-0002.vtu")
    assert piece.names("PointData") == ("u", "v", "node_groups", "GlobalNodeIds")
    rows = ARRAYS["u"][41:]
    found = piece.array("PointData", "u", rows.shape)
    memory: Any = found
    while isinstance(memory, np.ndarray | memoryview):
        memory = memory.base if isinstance(memory, np.ndarray) else memory.obj
    assert isinstance(memory, mmap.mmap)
    np.testing.assert_array_equal(found, rows)
    assert piece.array("CellData", "subdomain", (55, 20)).dtype == np.int32
    with pytest.raises(KeyError, match="w"):
        piece.array("PointData", "w", rows.shape)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    path.write_text('<VTKFile type="UnstructuredGrid"><UnstructuredGrid/></VTKFile>')
    with pytest.raises(ValueError, match=r"a\.vtu does not say which rows it holds"):
        Piece(path=path).where()
    with pytest.raises(IndexError):
        Pieces.of(path)
    path.write_text("VTKFile")
    with pytest.raises(SamplesError, match="the pvtu file cannot be read"):
        Pieces.of(path)


@pytest.mark.parametrize("cuts", CUTS, ids=str)
def test_h5py_reads_one_grid(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    with h5py.File(written(tmp_path, "vtkhdf", cuts)) as file:
        root = file["VTKHDF"]
        assert (root.attrs["Type"], root.attrs["Version"].tolist()) == (b"UnstructuredGrid", [1, 0])
        grid = DATA.mesh.grid
        counts = [root[f"NumberOf{name}"][:].tolist() for name in ("Points", "Cells", "ConnectivityIds")]
        assert counts == [[grid.points], [grid.cells], [4 * grid.cells]]
        np.testing.assert_array_equal(root["Points"][:, :2], DATA.mesh.points)
        assert not root["Points"][:, 2].any()
        np.testing.assert_array_equal(root["Connectivity"][:].reshape(-1, 4), DATA.mesh.cells)
        np.testing.assert_array_equal(root["Offsets"][:], 4 * np.arange(grid.cells + 1))
        assert np.all(root["Types"][:] == 9)
        for name in ("u", "v"):
            np.testing.assert_array_equal(root[f"PointData/{name}"][:], ARRAYS[name].ravel())
        np.testing.assert_array_equal(root["PointData/node_groups"][:], node_groups(DATA))
        np.testing.assert_array_equal(root["CellData/Q_eq"][:], ARRAYS["Q_eq"].ravel())
        np.testing.assert_array_equal(root["CellData/subdomain"][:], subdomains(cuts).ravel())


def test_rows_of_several_files_are_one_dataset(tmp_path: Path) -> None:
    for number, rows in enumerate((2, 3)):
        with create(tmp_path / f"{number}.h5") as file:
            file["a/u"] = np.full((rows, 4), float(number))
    sources = [Source(file="0.h5", first=0, last=2), Source(file="1.h5", first=2, last=5)]
    with create(tmp_path / "head.h5") as file:
        add_virtual(file, "a/u", (5, 4), np.float64, sources)
    with h5py.File(tmp_path / "head.h5") as file:
        assert file["a/u"].is_virtual
        np.testing.assert_array_equal(file["a/u"][:, 1], [0, 0, 1, 1, 1])
    (tmp_path / "0.h5").unlink()
    with h5py.File(tmp_path / "head.h5") as file:
        np.testing.assert_array_equal(file["a/u"][:, 1], [np.nan, np.nan, 1, 1, 1])


def test_old_libraries_can_read_the_files(tmp_path: Path) -> None:
    with create(tmp_path / "a.h5") as file:
        assert file.libver == ("v110", "v110")


@pytest.mark.parametrize("cuts", [*CUTS, (32, 64), (1, 2, 3, 31, 33, 95, 96)], ids=str)
def test_zarr_reads_one_group(tmp_path: Path, cuts: tuple[int, ...]) -> None:
    """Parts end where chunks end, inside of them, and several within one chunk."""
    head = written(tmp_path, "zarr", cuts)
    group = zarr.open_group(head, mode="r")
    for name, values in {**ARRAYS, "subdomain": subdomains(cuts)}.items():
        np.testing.assert_array_equal(group[name][:], values)
        in_cells = name in ("Q_eq", "subdomain")
        assert group[name].metadata.dimension_names == (("xi_cell", "eta_cell") if in_cells else ("xi", "eta"))
    np.testing.assert_array_equal(group["xi"][:], np.linspace(0, 1, N_XI))
    np.testing.assert_array_equal(group["eta"][:], np.linspace(0, 1, N_ETA))
    assert group.attrs["sides"] == {"left": {"xi": 0}, "right": {"xi": -1}, "bottom": {"eta": 0}, "top": {"eta": -1}}
    np.testing.assert_array_equal(da.from_zarr(head, component="u").compute(), ARRAYS["u"])
    assert [*tmp_path.iterdir()] == [head]
    assert "seams" not in {path.name for path in head.iterdir()}


def test_parts_leave_only_rows_of_chunks_that_they_share(tmp_path: Path) -> None:
    head = tmp_path / "mesh.zarr"
    for part in parts_of(CUTS[2]):
        write_part(head, part, data_of(part))
    with np.load(unfinished(head) / "seams" / "part-0002.npz") as file:  # of the rows 33 to 65
        assert {name: len(file[name]) for name in file.files if name.startswith("x ")} == {
            "x 1": 2 * CHUNK_ROWS - 33,
            "x 2": 66 - 2 * CHUNK_ROWS,
        }


def test_parts_of_another_mesh_are_refused(tmp_path: Path) -> None:
    head, cuts = tmp_path / "mesh.zarr", CUTS[1]
    for part in parts_of(cuts):
        write_part(head, part, data_of(part))
    with pytest.raises(InputError, match="have other arrays"):
        write_head(head, grid=DATA.mesh.grid, cuts=cuts, nodes=("u",), cells=("Q_eq",))
    with pytest.raises(InputError, match=r"part 1 below .* has other rows"):
        write_head(head, grid=DATA.mesh.grid, cuts=(33, 50), nodes=("u", "v"), cells=("Q_eq",))


def test_a_missing_zarr_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(InputError, match=r"zarr is not installed: pip install 'equimesh\[dask\]'"):
        zarr_parts.write_part(tmp_path / "mesh.zarr", parts_of(())[0], data_of(parts_of(())[0]))
