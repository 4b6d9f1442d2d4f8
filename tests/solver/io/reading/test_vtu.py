"""vtu files: our own back again, those of others with lines and pixels, and what broken ones are told."""

from __future__ import annotations

import time
from pathlib import Path

import meshio
import numpy as np
import pytest

from equimesh.io.reading.read import read_bytes, read_mesh
from equimesh.io.vtk import write_vtu
from solver.io.reading.plain import refusal, small


def text_of(types: str = "3 8", offsets: str = "2 6", cells: str = "0 1 0 1 2 3", points: int = 4) -> str:
    """A line of the side 7, and a pixel, whose nodes go to and fro."""

    def array(name: str, kind: str, values: str) -> str:
        return f'<DataArray type="{kind}" Name="{name}" format="ascii">{values}</DataArray>'

    return (
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{points}" NumberOfCells="2"><Points>'
        '<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 1 1 0 1 0 1 1 1 1 1</DataArray></Points>'
        f"<Cells>{array('connectivity', 'Int64', cells)}{array('offsets', 'Int64', offsets)}"
        f"{array('types', 'UInt8', types)}</Cells><CellData>{array('side', 'Int32', '7 0')}</CellData></Piece>"
        "</UnstructuredGrid></VTKFile>"
    )


def test_our_own_file_comes_back_to_the_bit_but_for_its_sides(tmp_path: Path) -> None:
    mesh = small()
    write_vtu(tmp_path / "mesh.vtu", mesh.points, mesh.cells, point_data={}, cell_data={})
    found = read_mesh(tmp_path / "mesh.vtu")
    np.testing.assert_array_equal(found.points, mesh.points)
    np.testing.assert_array_equal(found.cells, mesh.cells)
    assert found.sides == {}


def test_compressed_files_of_others(tmp_path: Path) -> None:
    mesh = small()
    edges = np.concatenate(list(mesh.sides.values()))
    tags = [np.repeat([1, 2, 3, 4], [2, 2, 3, 3]), np.zeros(6, int)]
    points = np.pad(mesh.points, ((0, 0), (0, 1)))
    written = meshio.Mesh(points, [("line", edges), ("quad", mesh.cells)], cell_data={"boundary": tags})
    meshio.write(tmp_path / "mesh.vtu", written, compression="zlib")
    found = read_mesh(tmp_path / "mesh.vtu")
    np.testing.assert_array_equal(found.points, mesh.points)
    np.testing.assert_array_equal(found.cells, mesh.cells)
    for k, side in enumerate(mesh.sides.values(), start=1):
        np.testing.assert_array_equal(found.sides[f"group_{k}"], side)


def test_a_pixel_is_a_cell_and_a_line_is_of_a_side() -> None:
    mesh = read_bytes(text_of().encode(), "vtu")
    assert mesh.cells.tolist() == [[0, 1, 3, 2]]
    assert mesh.sides["group_7"].tolist() == [[0, 1]]


BROKEN = {
    "is a triangle: only quadrilaterals": text_of(types="3 5"),
    "is a cell of the type 99": text_of(types="3 99"),
    "does not have the 2 nodes of its type": text_of(offsets="3 6"),
    "the offsets of the vtu file fall": text_of(offsets="2 1"),
    "has the nodes [0, 1, 9, 2], but the file has 4 nodes": text_of(cells="0 1 0 1 2 9"),
    "has 12 numbers where 15 are expected": text_of(points=5),
    "no array 'types'": text_of().replace("types", "kinds"),
    "has no points": text_of().replace("Points>", "Places>"),
    "has 0 pieces": text_of().replace("Piece", "Part"),
    "the vtu file cannot be read": text_of().replace('NumberOfCells="2"', 'NumberOfCells="b"'),
}


@pytest.mark.parametrize("told", BROKEN)
def test_broken_files_are_refused_with_what_is_wrong(told: str) -> None:
    assert told in refusal(BROKEN[told], "vtu")


def test_too_many_groups_are_refused_before_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.io.reading.plain_mesh.MAX_SIDES", 0)
    assert "there are 1 named sides: 0 are possible" in refusal(text_of(), "vtu")


def test_a_file_that_unpacks_to_very_much_is_refused(tmp_path: Path) -> None:
    points = np.zeros((200_000, 3))
    meshio.write(tmp_path / "mesh.vtu", meshio.Mesh(points, [("quad", [[0, 1, 2, 3]])]), compression="zlib")
    assert (tmp_path / "mesh.vtu").stat().st_size < points.nbytes / 100
    assert "more data than the limit allows" in refusal((tmp_path / "mesh.vtu").read_bytes(), "vtu")


def test_sides_that_share_an_array_are_counted_soon() -> None:
    side = '<DataArray type="Int64" Name="sides/s{}" NumberOfComponents="2" NumberOfTuples="0" format="{}" offset="1"/>'
    sides = "".join(side.format(k, "appended") for k in range(10_000))
    text = text_of().replace("<Piece", f"<FieldData>{sides}</FieldData><Piece", 1)
    data = text.replace("</VTKFile>", '<AppendedData encoding="raw">_').encode()
    began = time.process_time()
    assert "named sides: 1000 are possible" in refusal(data + bytes(1 << 26) + b"</AppendedData></VTKFile>", "vtu")
    assert time.process_time() - began < 8.0
