"""Raw appended data: offsets, counts and bytes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from equimesh.io.by_parts.vtk_raw import RawArray, described, head_text, vtk_type, write_raw

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
