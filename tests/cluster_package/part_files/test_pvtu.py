"""Unstructured grids in parts: their bytes, cells by the nodes of their part, numbers in the whole mesh, the sides."""

from __future__ import annotations

import mmap
import pickle
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cluster_package.part_files.parted import ARRAYS, CUTS, DATA, parts_of, written
from equimesh.errors import SamplesError
from equimesh.io.reading.vtk import VtkXml
from equimesh.io.write import node_groups
from equimesh_cluster.part_files.pvtu import Piece, Pieces, RawArray, described, head_text, vtk_type, write_raw

A, B = np.arange(6.0), np.array([[1, 2, 3]], dtype=np.int32)


def arrays() -> dict[str, list[RawArray]]:
    first = RawArray(name="a", dtype=np.float64, count=6, blocks=lambda: iter([A[:4], A[4:]]))
    second = RawArray(name="b", dtype=np.int32, count=3, components=3, blocks=lambda: iter([B]))
    return {"PointData": [first], "CellData": [second]}


def test_bytes_follow_their_count(tmp_path: Path) -> None:
    path = tmp_path / "a.vtu"
    write_raw(path, "UnstructuredGrid", "", 'NumberOfPoints="6"', arrays())
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
        write_raw(tmp_path / "a.vtu", "UnstructuredGrid", "", "", {"PointData": [short]})


def test_a_head_is_xml() -> None:
    names = [described("u", np.float64), described("GlobalNodeIds", np.int64)]
    root = ET.fromstring(head_text("PUnstructuredGrid", "", {"PPointData": names}, ['<Piece Source="a"/>']))
    section = root.find("PUnstructuredGrid/PPointData")
    assert section is not None
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


def test_rows_are_read_by_a_copy_in_another_process(tmp_path: Path) -> None:
    rows = Pieces.of(written(tmp_path, "pvtu", CUTS[1]))
    copy = pickle.loads(pickle.dumps(rows))
    np.testing.assert_array_equal(copy.rows("y", 40, 42), ARRAYS["y"][40:42])
    assert copy.parted.cuts == CUTS[1]
