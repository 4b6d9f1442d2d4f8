"""A mesh from a file: the format by the suffix, SU2, and whatever is broken becomes one kind of error."""

from __future__ import annotations

import io
import re
import struct
import time
import zipfile
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

import equimesh as em
from block_cases import data_of
from equimesh.blocks.blocks import Blocks
from equimesh.errors import InputError
from equimesh.io.reading.plain_mesh import PlainMesh, refuse_cell
from equimesh.io.reading.read import description_format, read_bytes, read_description, read_mesh
from equimesh.io.solver_files import su2_text
from equimesh.io.vtk import write_vtu
from equimesh.io.write import write_mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.numerics.types import Array
from equimesh.testing import GEOMETRIES
from solver.io.reading.cgns_files import Condition, cgns
from solver.io.reading.plain import refusal, same, small
from solver.io.reading.test_foam import zipped


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


def test_a_zip_has_one_mesh_of_bounded_size(monkeypatch: pytest.MonkeyPatch) -> None:
    packed = zipped({"points": "", "polyMesh/points": ""})
    with pytest.raises(InputError, match="the zip has two files 'points'"):
        read_bytes(packed, "zip")
    monkeypatch.setattr("equimesh.io.reading.bounds.MAX_EXPANDED", 100)
    with pytest.raises(InputError, match="the zip file unpacks to more than the bytes allowed"):
        read_bytes(zipped({"points": "0" * 60, "faces": "0" * 60}), "zip")


# Meshes from CGNS files of structured zones.


def zone(x: float, y: float, n_i: int, n_j: int) -> Array:
    """Nodes of a rectangle of cells of the size 1, shape ``(n_i, n_j, 2)``."""
    return np.stack(np.meshgrid(x + np.arange(n_i), y + np.arange(n_j), indexing="ij"), axis=-1).astype(float)


def l_shape(axes: int = 2) -> dict[str, tuple[Array, list[Condition]]]:
    """Three zones, with sides at nodes, on faces, and of a family."""
    last = [] if axes == 2 else [1], [] if axes == 2 else [2]

    def span(i: int, j: int, i_end: int, j_end: int) -> list[list[int]]:
        return [[i, j, *last[0]], [i_end, j_end, *last[1]]]

    return {
        "zone 10": (zone(0, 0, 4, 3), [("bc1", span(1, 1, 4, 1), "floor", ""), ("inlet", span(1, 1, 1, 3), "", "")]),
        "zone 2": (
            zone(3, 0, 3, 3),
            [("bc1", span(1, 1, 2, 1), "floor", "JFaceCenter"), ("out", span(3, 1, 3, 2), "", "FaceCenter")],
        ),
        "zone 1": (zone(0, 2, 4, 2), [("inlet", span(1, 1, 1, 2), "", "Vertex")]),
    }


@pytest.mark.parametrize("axes", [2, 3])
def test_zones_are_blocks_and_boundary_conditions_are_sides(axes: int) -> None:
    found = read_bytes(cgns(l_shape(axes), axes), "cgns")
    assert found.blocks == (("zone 10", 6), ("zone 2", 4), ("zone 1", 3))
    assert len(found.points) == 12 + 6 + 4
    assert list(found.sides) == ["floor", "inlet", "out"]
    middle = {name: found.points[edges].mean(axis=1).tolist() for name, edges in found.sides.items()}
    assert middle["floor"] == [[0.5, 0], [1.5, 0], [2.5, 0], [3.5, 0], [4.5, 0]]
    assert middle["inlet"] == [[0, 0.5], [0, 1.5], [0, 2.5]]
    assert middle["out"] == [[5, 0.5], [5, 1.5]]
    domain = Blocks.of_plain(found)
    assert domain.mesh.block_names == ("zone 10", "zone 2", "zone 1")
    assert domain.area == pytest.approx(13)


def test_faces_in_the_plane_are_no_side() -> None:
    zones = l_shape(3)
    zones["zone 1"][1].append(("front", [[1, 1, 1], [4, 2, 1]], "", ""))
    assert list(read_bytes(cgns(zones, 3), "cgns").sides) == ["floor", "inlet", "out"]


def test_what_is_wrong_is_named_with_its_zone() -> None:
    good = l_shape()
    nodes = good["zone 2"][0]

    def with_condition(*condition: object) -> bytes:
        return cgns(good | {"zone 2": (nodes, [condition])})

    for data, message in [
        (b"\x00ADF Database", "the CGNS file is no HDF5 file: convert it by cgnsconvert to HDF5"),
        (b"CGNS", "the CGNS file is no HDF5 file: save it again"),
        (cgns({}), "the CGNS file has 1 bases and 0 zones"),
        (cgns(good, kind="Unstructured"), "the zone 'zone 10' is Unstructured: structured zones are read; save it as"),
        (with_condition("w", [[1, 1], [9, 1]], "", ""), "the zone 'zone 2': the boundary condition 'w' has the points"),
        (with_condition("w", [[2, 1], [2, 3]], "", ""), r"points \[2, 1\] to \[2, 3\], which are no part of a side"),
        (with_condition("w", [[1, 1], [3, 1]], "", "JFaceCenter"), "which are no part of a side of the 3 x 3 nodes"),
        (with_condition("w", [[1, 1], [3, 1]], "", "CellCenter"), "a PointRange at CellCenter of the shape"),
        (with_condition("w", [], "", ""), "the boundary condition 'w' has no PointRange: give the range of its points"),
    ]:
        found = refusal(data, "cgns")
        assert re.search(message, found), found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("gone", "the zone 'zone 2' has no CoordinateY: x and y are needed"),
        ("link", "the zone 'zone 2' has no CoordinateY: x and y are needed"),
        ("packed", "the zone 'zone 2': CoordinateY has no plain array: save the file as one"),
        ("small", "the zone 'zone 2': CoordinateY has (2, 3) nodes where the zone has (3, 3)"),
        ("text", "the zone 'zone 2': CoordinateY has 3 entries of the type"),
    ],
)
def test_coordinates_that_cannot_be_read_are_named(change: str, message: str) -> None:
    stream = io.BytesIO(cgns(l_shape()))
    with h5py.File(stream, "r+") as file:
        grid = file["Base/zone 2/GridCoordinates"]
        if change in ("gone", "link"):
            del grid["CoordinateY"]
        if change == "link":
            grid["CoordinateY"] = h5py.ExternalLink("/etc/passwd", "/data")
        if change in ("packed", "small", "text"):
            del grid["CoordinateY/ data"]
            if change == "packed":
                grid.create_dataset("CoordinateY/ data", data=np.zeros((3, 3)), compression="gzip")
            elif change == "small":
                grid.create_dataset("CoordinateY/ data", data=np.zeros((3, 2)))
            else:
                grid.create_dataset("CoordinateY/ data", data=["a", "b", "c"])
    assert message in refusal(stream.getvalue(), "cgns")


def test_zones_that_share_one_array_are_refused() -> None:
    stream = io.BytesIO(cgns({"zone": (np.moveaxis(np.indices((60, 60), dtype=np.float64), 0, 2), [])}))
    with h5py.File(stream, "r+") as file:
        for number in range(9):
            file[f"Base/again {number}"] = file["Base/zone"]
    with pytest.raises(InputError, match=r"has more nodes than the file has place for: save each zone"):
        read_bytes(stream.getvalue(), "cgns")


def test_sides_with_more_edges_than_the_zones_are_refused() -> None:
    ends = [[1, 1], [4, 1]]
    conditions = [(f"wall {number}", ends, "", "") for number in range(6)]
    with pytest.raises(InputError, match="the sides have more edges than the zones"):
        read_bytes(cgns({"zone": (np.moveaxis(np.indices((4, 3), dtype=np.float64), 0, 2), conditions)}), "cgns")


# Descriptions from files: JSON and blockMeshDict, by the name of the file.


@pytest.mark.parametrize(
    ("name", "format"),
    [
        ("a/l.json", "json"),
        ("L.JSON", "json"),
        ("system/blockMeshDict", "blockMeshDict"),
        ("blockMeshDict.2", "blockMeshDict"),
        ("x.msh", None),
    ],
)
def test_the_name_tells_the_format(name: str, format: str | None) -> None:
    assert description_format(name) == format


def test_the_object_of_a_json(tmp_path: Path) -> None:
    (tmp_path / "l.json").write_text('{"blocks": [{"cells": [1, 2]}]}')
    assert read_description(tmp_path / "l.json", "json") == {"blocks": [{"cells": [1, 2]}]}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b'{"a": 1,\n "b": }', "line 2: Expecting value: this is no JSON"),
        (b"[1]", "the JSON is no object"),
        (b" \n", "the file is empty: give one that holds a mesh"),
        (b"[" * 100_000, "the JSON cannot be read"),
        (b"\xff\xfe", "l.json is no text in UTF-8"),
    ],
)
def test_what_is_no_description_is_refused(tmp_path: Path, content: bytes, told: str) -> None:
    (tmp_path / "l.json").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_description(tmp_path / "l.json", "json")
    assert told in caught.value.message
    with pytest.raises(InputError, match=r"none.json cannot be read"):
        read_description(tmp_path / "none.json", "json")


# Binary Gmsh files: both versions, both orders of bytes, blocks of one element, and sections that end too early.


def head(version: str, order: str) -> bytes:
    return f"$MeshFormat\n{version} 1 8\n".encode() + struct.pack(f"{order}i", 1) + b"\n$EndMeshFormat\n"


def sections(**found: bytes) -> bytes:
    return b"".join(f"${name}\n".encode() + body + f"\n$End{name}\n".encode() for name, body in found.items())


def names() -> bytes:
    sides = list(small().sides)
    return "\n".join([str(len(sides)), *(f'1 {k} "{name}"' for k, name in enumerate(sides, start=1))]).encode()


def version_2(order: str, *, single: bool) -> bytes:
    """The small mesh; with ``single`` each element has a block of its own, as some programs write them."""
    mesh = small()
    nodes = np.zeros(len(mesh.points), np.dtype([("tag", f"{order}i4"), ("at", f"{order}f8", (3,))]))
    nodes["tag"], nodes["at"][:, :2] = np.arange(1, len(nodes) + 1), mesh.points
    tables = [(1, k, edges) for k, edges in enumerate(mesh.sides.values(), start=1)] + [(3, 9, mesh.cells)]
    count = sum(len(table) for _, _, table in tables)
    elements, number = f"{count}\n".encode(), 0
    for kind, group, table in tables:
        for rows in table[:, None] if single else [table]:
            elements += np.array([kind, len(rows), 2], f"{order}i4").tobytes()
            for row in rows:
                number += 1
                elements += np.array([number, group, group, *(row + 1)], f"{order}i4").tobytes()
    counted = f"{len(nodes)}\n".encode() + nodes.tobytes()
    return head("2.2", order) + sections(PhysicalNames=names(), Nodes=counted, Elements=elements)


def version_4(order: str) -> bytes:
    mesh = small()

    def longs(*numbers: int) -> bytes:
        return np.array(numbers, f"{order}u8").tobytes()

    def ints(*numbers: int) -> bytes:
        return np.array(numbers, f"{order}i4").tobytes()

    entities = longs(0, len(mesh.sides), 1, 0)
    for k in range(1, len(mesh.sides) + 1):
        entities += ints(k) + np.zeros(6, f"{order}f8").tobytes() + longs(1) + ints(k) + longs(2) + ints(1, -2)
    places = np.pad(mesh.points, ((0, 0), (0, 1))).astype(f"{order}f8").tobytes()
    count = len(mesh.points)
    nodes = longs(1, count, 1, count) + ints(2, 1, 0) + longs(count, *range(1, count + 1)) + places
    blocks = [(1, k, 1, edges) for k, edges in enumerate(mesh.sides.values(), start=1)] + [(2, 1, 3, mesh.cells)]
    total = sum(len(table) for *_, table in blocks)
    elements = longs(len(blocks), total, 1, total)
    for dimension, entity, kind, table in blocks:
        elements += ints(dimension, entity, kind) + longs(len(table))
        elements += b"".join(longs(number, *(row + 1)) for number, row in enumerate(table, start=1))
    return head("4.1", order) + sections(PhysicalNames=names(), Entities=entities, Nodes=nodes, Elements=elements)


FILES = {
    "2.2": version_2("<", single=False),
    "2.2, large end first": version_2(">", single=False),
    "2.2, a block for each element": version_2("<", single=True),
    "4.1": version_4("<"),
    "4.1, large end first": version_4(">"),
}


@pytest.mark.parametrize("name", FILES)
def test_the_mesh_comes_back(name: str) -> None:
    assert same(read_bytes(FILES[name], "msh"), small())


@pytest.mark.parametrize("name", ["2.2", "4.1"])
def test_a_section_that_ends_too_early_is_told(name: str) -> None:
    data = FILES[name]
    at = data.index(b"\n$EndElements")
    assert "ends too early" in refusal(data[: at - 40] + data[at:], "msh")


def test_the_order_of_bytes_has_to_be_told() -> None:
    assert "order of its bytes" in refusal(FILES["2.2"].replace(b"2.2 1 8\n\x01\0\0\0", b"2.2 1 8\n\x07\0\0\0"), "msh")


# Meshes from VTK's files of several blocks.


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
        (text.replace("mesh_1.vts", "../mesh_1.vts"), r"block 1 of the vtm file is in '../mesh_1.vts': its file"),
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


# vtu files: our own back again, those of others with lines and pixels, and what broken ones are told.


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


POINTS = np.array([[9.0, 9], [0, 0], [1, 0], [7, 7], [1, 1], [0, 1]])
CELLS = np.array([[1, 2, 4, 5]])


def test_points_that_no_cell_uses_are_left_out() -> None:
    mesh = PlainMesh.of(POINTS, CELLS, {"low": np.array([[1, 2]])}, {"te": 4, "centre": 3})
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert mesh.cells.tolist() == [[0, 1, 2, 3]]
    assert mesh.sides["low"].tolist() == [[0, 1]]
    assert mesh.places == {"te": 2}


def test_a_third_coordinate_must_be_constant_where_it_is_used() -> None:
    space = np.pad(POINTS, ((0, 0), (0, 1)), constant_values=2.0)
    space[0, 2] = 5.0
    assert PlainMesh.of(space, CELLS, {}).points.shape == (4, 2)
    space[2, 2] = 2.5
    with pytest.raises(InputError, match=r"node 2 has z = 2.5, node 1 has z = 2;"):
        PlainMesh.of(space, CELLS, {})


def test_faults_are_named() -> None:
    with pytest.raises(InputError, match="no quadrilaterals"):
        PlainMesh.of(POINTS, np.empty((0, 4), int), {})
    with pytest.raises(InputError, match=r"the cells: number 0 has the nodes \[1, 2, 4, 6\], but the file has 6 nodes"):
        PlainMesh.of(POINTS, np.array([[1, 2, 4, 6]]), {})
    with pytest.raises(InputError, match=r"the side 'low' has the edge \[1, 3\] of nodes that no cell has"):
        PlainMesh.of(POINTS, CELLS, {"low": np.array([[1, 3]])})
    bad = POINTS.copy()
    bad[4, 1] = np.inf
    with pytest.raises(InputError, match=r"node 4 has the coordinates \[1.0, inf\]"):
        PlainMesh.of(bad, CELLS, {})


def test_the_place_of_another_cell_is_named_where_it_is_known() -> None:
    assert (
        "cell 3 of the file near (0.5, 0) is a triangle" in refuse_cell("triangle", 3, POINTS, np.array([1, 2])).message
    )
    assert "cell 3 of the file is a triangle" in refuse_cell("triangle", 3, POINTS, np.array([-1, 99])).message


def test_too_many_sides_are_refused() -> None:
    mesh = small()
    sides = {f"s{k}": mesh.cells[:1, :2] for k in range(1001)}
    with pytest.raises(InputError, match="there are 1001 named sides: 1000 are possible"):
        PlainMesh.of(mesh.points, mesh.cells, sides)


def test_cells_and_edges_that_are_there_often_are_refused() -> None:
    with pytest.raises(InputError, match="the file has 5 cells of 4 nodes: some lie on each other"):
        PlainMesh.of(POINTS, np.repeat(CELLS, 5, axis=0), {})
    with pytest.raises(InputError, match="the sides have 42 edges, the mesh 1 cells: name each edge once"):
        PlainMesh.of(POINTS, CELLS, {name: np.repeat(CELLS[:, :2], 21, axis=0) for name in "ab"})


SHORT = """% comment
NPOIN= 4
0. 0. 0
1. 1. 2
1. 0. 1  % points in any order
0. 1. 3
NDIME= 2
NELEM= 1
9 0 1 2 3
NMARK= 1
MARKER_TAG= wall
MARKER_ELEMS= 2
3 0 1
3 1 2
"""


def test_our_own_file_comes_back_to_the_bit() -> None:
    mesh = small()
    assert same(read_bytes(su2_text(mesh.points, mesh.cells, mesh.sides).encode(), "su2"), mesh)


def test_elements_without_numbers_and_points_in_any_order() -> None:
    mesh = read_bytes(SHORT.encode(), "su2")
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert mesh.cells.tolist() == [[0, 1, 2, 3]]
    assert mesh.sides["wall"].tolist() == [[0, 1], [1, 2]]


def test_a_marker_without_elements_is_no_side() -> None:
    text = SHORT.replace("NMARK= 1", "NMARK= 2\nMARKER_TAG= gone\nMARKER_ELEMS= 0")
    assert [*read_bytes(text.encode(), "su2").sides] == ["wall"]
    assert "are told, but" in refusal(text.replace("MARKER_ELEMS= 0", "MARKER_ELEMS= 0\n3 0 1").encode(), "su2")


def test_points_without_numbers() -> None:
    mesh = small()
    text = su2_text(mesh.points, mesh.cells, mesh.sides)
    head, _, rest = text.partition("NPOIN= 12\n")
    rows, marks = rest.split("NMARK")
    plain = "\n".join(" ".join(row.split()[:2]) for row in rows.splitlines())
    assert same(read_bytes(f"{head}NPOIN= 12\n{plain}\nNMARK{marks}".encode(), "su2"), mesh)


BROKEN_SU2 = {
    "line 4: 'a' is no number, among the points": SHORT.replace("1. 1. 2", "1. a 2"),
    "no NELEM=": SHORT.replace("NELEM", "ELEM"),
    "line 7: the SU2 mesh has 3 dimensions, not 2": SHORT.replace("NDIME= 2", "NDIME= 3"),
    "line 2: NPOIN= 'x' is no number of rows": SHORT.replace("NPOIN= 4", "NPOIN= x"),
    "line 2: 5 points with x and y are told": SHORT.replace("NPOIN= 4", "NPOIN= 5"),
    "line 2: the points are not numbered from 0 to 3": SHORT.replace("0. 1. 3", "0. 1. 5"),
    "is a triangle: only quadrilaterals": SHORT.replace("9 0 1 2 3", "5 0 1 2 0"),
    "line 14: a triangle in a marker": SHORT.replace("3 1 2", "5 1 2"),
    "number 1 has the nodes [1, 7], but the file has 4 nodes": SHORT.replace("3 1 2", "3 1 7"),
}


@pytest.mark.parametrize("told", BROKEN_SU2)
def test_broken_files_are_refused_with_the_place(told: str) -> None:
    assert told in refusal(BROKEN_SU2[told], "su2")


def test_the_place_of_a_triangle_is_its_middle() -> None:
    text = SHORT.replace("NELEM= 1\n9 0 1 2 3", "NELEM= 2\n9 0 1 2 3\n5 1 2 3")
    assert "cell 1 of the file near (0.666667, 0.666667) is a triangle" in refusal(text, "su2")


def test_an_empty_file_is_told_what_it_lacks() -> None:
    assert refusal(b"%", "su2") == "the SU2 file has no NDIME="
    assert refusal(b"", "su2").startswith("the file is empty")
