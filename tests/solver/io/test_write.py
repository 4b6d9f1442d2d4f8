"""Writing files: VTK and XDMF read back, formats by name and suffix, and nothing left behind by a failure."""

from __future__ import annotations

import base64
import os
import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest

import equimesh
from block_cases import changed, data_of, l_shape
from equimesh.errors import InputError
from equimesh.io.write import (
    FORMATS,
    Cells,
    cell_data,
    corners_of,
    node_groups,
    per_quad,
    point_data,
    side_data,
    write_mesh,
)
from equimesh.meshes.mesh import SIDES
from solver.io.files import (
    CELL_COUNT,
    DATA,
    EDGES,
    KINDS,
    N_ETA,
    N_XI,
    check_cells,
    check_edges,
    check_mesh,
    per_cell,
    written,
)


@pytest.mark.parametrize("kind", KINDS)
class TestReadBack:
    def test_vtk(self, tmp_path: Path, kind: Cells) -> None:
        path = written(tmp_path, "vtk", kind)
        found = meshio.vtk.read(path)
        groups = found.point_data.pop("node_groups")
        check_mesh(found, kind, dimension=3)
        for number, side in enumerate(SIDES, start=1):
            on_side = [str(number) in str(group) for group in groups.tolist()]
            np.testing.assert_array_equal(np.flatnonzero(on_side), np.unique(DATA.mesh.sides[side]))
        assert groups.dtype.itemsize == 4
        assert sorted({*groups.tolist()}) == [0, 1, 2, 3, 4, 13, 14, 23, 24]
        data = path.read_bytes()
        lines = data.split(b"\n", 4)
        assert lines[0] == b"# vtk DataFile Version 4.2"
        assert lines[2:4] == [b"BINARY", b"DATASET UNSTRUCTURED_GRID"]
        assert lines[4].startswith(b"POINTS 35 double\n")
        corners = 3 if kind == "triangle" else 4
        count = 2 * CELL_COUNT if kind == "triangle" else CELL_COUNT
        _, head, rest = data.partition(f"\nCELLS {count} {count * (corners + 1)}\n".encode())
        assert head, "the layout of versions before 5"
        cells = np.frombuffer(rest, ">i4", count * (corners + 1)).reshape(count, corners + 1)
        assert np.all(cells[:, 0] == corners)
        check_cells(DATA.mesh.points, cells[:, 1:], kind)
        _, head, rest = data.partition(f"\nCELL_TYPES {count}\n".encode())
        assert np.all(np.frombuffer(rest, ">i4", count) == (5 if kind == "triangle" else 9))
        assert f"\nsubdomain 1 {count} int\n".encode() in data

    def test_xdmf(self, tmp_path: Path, kind: Cells) -> None:
        path = written(tmp_path, "xdmf", kind)
        with zipfile.ZipFile(path) as archive:
            assert archive.testzip() is None
            assert archive.namelist() == ["mesh.xdmf", "mesh.h5", "facets.xdmf", "facets.h5"]
            archive.extractall(tmp_path)
        check_mesh(meshio.xdmf.read(tmp_path / "mesh.xdmf"), kind, dimension=2)
        facets = meshio.xdmf.read(tmp_path / "facets.xdmf")
        tags = facets.cell_data["name_to_read"][0]
        for number, side in enumerate(SIDES, start=1):
            check_edges(DATA.mesh.points, facets.cells_dict["line"][tags == number], side)
        np.testing.assert_array_equal(facets.points, DATA.mesh.points)
        text = (tmp_path / "mesh.xdmf").read_text()
        assert text.count('<Time Value="0"/>') == 1
        assert 'GeometryType="XY"' in text
        assert f'TopologyType="{"Triangle" if kind == "triangle" else "Quadrilateral"}"' in text
        for stem, part in (("mesh", text), ("facets", (tmp_path / "facets.xdmf").read_text())):
            with h5py.File(tmp_path / f"{stem}.h5") as heavy:
                pointers = re.findall(r'Dimensions="([\d ]+)"[^>]*>([^<]+)<', part)
                assert len(pointers) == 2 * (7 if stem == "mesh" else 3)
                for dimensions, pointer in pointers:
                    file, _, dataset = pointer.partition(":")
                    assert file == f"{stem}.h5"
                    assert heavy[dataset].shape == tuple(map(int, dimensions.split()))
        with h5py.File(tmp_path / "mesh.h5") as heavy:
            np.testing.assert_array_equal(heavy["data0"][:], DATA.mesh.points)

    def test_the_same_mesh_gives_the_same_bytes(self, tmp_path: Path, kind: Cells) -> None:
        def contents(name: str) -> bytes:
            return written(tmp_path, name, kind).read_bytes()

        names = [name for name, known in FORMATS.items() if kind in known.cells]
        first = {name: contents(name) for name in names}
        time.sleep(2.1)  # beyond the two seconds of a zip's clock
        assert {name: contents(name) for name in names} == first

    def test_unpacked_xdmf(self, tmp_path: Path, kind: Cells) -> None:
        names = ["run.xdmf", "run.h5", "run_facets.xdmf", "run_facets.h5"]
        written = write_mesh(tmp_path / "run.xdmf", DATA, cells=kind)
        assert written[0].name == "run.xdmf"
        assert sorted(p.name for p in written) == sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
        check_mesh(meshio.xdmf.read(tmp_path / "run.xdmf"), kind, dimension=2)
        assert meshio.xdmf.read(tmp_path / "run_facets.xdmf").cells_dict["line"].shape == (sum(EDGES.values()), 2)


class TestRefusals:
    @pytest.mark.parametrize("name", ["stl", "", "VTU", "xdmf.zip"])
    def test_unknown_formats(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match="abaqus, hohqmesh, re2, nmsh, specfem, p3d, foam, npz") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA, format=name)
        assert caught.value.field == "format"
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["mesh", "mesh.stl", "mesh.zip", "vtu"])
    def test_unknown_suffixes(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(
            InputError, match=r"\.vtu, \.vtk, \.vts, \.vtm\.zip, .*, \.npz, \.xdmf, \.vtm, \.xyz, \.p3d"
        ):
            write_mesh(tmp_path / name, DATA)

    @pytest.mark.parametrize("name", ["m.vtu", "m.xdmf"])
    def test_folders_that_do_not_exist(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "none" / name
        with pytest.raises(InputError) as caught:
            write_mesh(path, DATA)
        assert caught.value.field == "path"
        assert str(caught.value) == f"{path}: there is no folder {path.parent}; make it first"

    def test_what_is_no_data(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"give the data of a solution, solution\.data\(\)") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA.mesh)  # type: ignore[arg-type]
        assert caught.value.field == "data"
        assert list(tmp_path.iterdir()) == []

    def test_triangles_in_a_structured_grid(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="a vts file holds no triangles: choose another format, or quad") as caught:
            write_mesh(tmp_path / "mesh.vts", DATA, cells="triangle")
        assert caught.value.field == "cells"
        assert list(tmp_path.iterdir()) == []

    def test_unknown_cells(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="quad or triangle") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA, cells="hexagon")  # type: ignore[arg-type]
        assert caught.value.field == "cells"


class TestDisk:
    def test_the_suffix_gives_the_format(self, tmp_path: Path) -> None:
        for name, known in FORMATS.items():
            by_suffix, by_name = tmp_path / f"a{known.suffix}", tmp_path / f"a-{name}.part"
            write_mesh(by_suffix, DATA)
            write_mesh(str(by_name), DATA, format=name)
            assert by_suffix.read_bytes() == by_name.read_bytes()

    @pytest.mark.parametrize("name", FORMATS)
    def test_a_failure_leaves_nothing_and_keeps_the_old_file(
        self, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "mesh.out"
        path.write_text("old")

        def full(*_: Any, **__: Any) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", full)
        with pytest.raises(OSError, match="No space left"):
            write_mesh(path, DATA, format=name)
        assert [p.name for p in tmp_path.iterdir()] == ["mesh.out"]
        assert path.read_text() == "old"

    def test_a_failing_writer_leaves_nothing(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def full(path: Path, *_: Any, **__: Any) -> None:
            Path(path).write_text("half a file")
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(meshio, "write", full)
        monkeypatch.setattr("equimesh.io.write.write_vtu", full)
        for name in ("vtu", "vtk", "xdmf"):
            with pytest.raises(OSError, match="No space left"):
                write_mesh(tmp_path / "mesh.out", DATA, format=name)
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.skipif(sys.platform == "win32", reason="a limit of the size of files stands for a full disk")
    def test_a_disk_that_fills_up_is_an_error_of_hdf5_too(self, tmp_path: Path) -> None:
        code = """
import resource, sys
from equimesh.io.write import write_mesh
from solver.io.files import DATA
resource.setrlimit(resource.RLIMIT_FSIZE, (512, 512))
try:
    write_mesh(sys.argv[1], DATA)
except OSError as error:
    print(error.strerror)
"""
        command = [sys.executable, "-c", code, str(tmp_path / "mesh.hdf")]
        done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, "File too large\n", "")
        assert list(tmp_path.iterdir()) == []

    def test_a_file_is_readable_as_any_new_file(self, tmp_path: Path) -> None:
        (tmp_path / "plain").touch()
        write_mesh(tmp_path / "mesh.vtu", DATA)
        assert (tmp_path / "mesh.vtu").stat().st_mode == (tmp_path / "plain").stat().st_mode


class TestFormats:
    def test_only_io_imports_meshio(self) -> None:
        folder = Path(equimesh.__file__).parent
        importers = [
            p.name for p in folder.rglob("*.py") if re.search(r"^\s*(import|from) meshio", p.read_text(), re.M)
        ]
        assert {*importers} == {"write.py"}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["vtu", "vtk", "xdmf"])
def test_vectors_have_three_components(tmp_path: Path, name: str, kind: Cells) -> None:
    x = DATA.mesh.x
    vectors, per_cell = np.stack([x, 2 * x], axis=-1), np.stack([DATA.q_eq] * 3, axis=-1)
    data = replace(DATA, fields={"velocity": vectors, "four": np.stack([x] * 4, axis=-1)}, cell_fields={"w": per_cell})
    path = tmp_path / ("mesh.xdmf" if name == "xdmf" else f"mesh.{name}")
    write_mesh(path, data, cells=kind)
    found = meshio.read(path)
    np.testing.assert_array_equal(
        found.point_data["velocity"], np.column_stack([x.ravel(), 2 * x.ravel(), 0 * x.ravel()])
    )
    assert {"four_0", "four_1", "four_2", "four_3"} < {*found.point_data}
    np.testing.assert_array_equal(
        found.cell_data["w"][0], np.repeat(per_cell.reshape(-1, 3), 1 if kind == "quad" else 2, axis=0)
    )


# The data of a mesh as files take them.


def test_fields_are_rows_and_only_grids_have_computational_coordinates() -> None:
    data = data_of(l_shape())
    found = point_data(data)
    assert [*found] == ["u", "rho", "flow"]
    assert found["flow"].shape == (65, 3)
    assert not found["flow"][:, 2].any()
    assert [*point_data(DATA)] == ["u", "xi", "eta"]
    many = replace(data, fields={"all": np.arange(65 * 4.0).reshape(65, 4)})
    assert point_data(many)["all_3"][:2].tolist() == [3.0, 7.0]


def test_triangles_inherit_the_values_of_their_quadrilateral() -> None:
    data = data_of(l_shape())
    quads, triangles = cell_data(data, "quad"), cell_data(data, "triangle")
    for name, values in quads.items():
        assert np.array_equal(np.repeat(values, per_quad("triangle"), axis=0), triangles[name]), name
    assert corners_of(data, "triangle").shape == (96, 3)
    assert corners_of(data, "quad") is data.mesh.cells


def test_sides_of_blocks_are_arrays_of_edges_and_groups_of_nodes() -> None:
    data = data_of(l_shape())
    assert {name: len(edges) for name, edges in side_data(data, data.mesh.sides).items()} == {
        "sides/inlet": 8,
        "sides/outlet": 4,
        "sides/wall": 20,
    }
    assert side_data(DATA, DATA.mesh.sides) == {}
    groups = node_groups(data)
    assert groups[data.mesh.blocks[0][0, 0]] == 13
    assert {*groups.tolist()} == {0, 1, 2, 3, 13, 23}


def test_ten_sides_have_two_digits_each() -> None:
    mesh = l_shape()
    wall = mesh.sides["wall"]
    sides = {"inlet": mesh.sides["inlet"], "outlet": mesh.sides["outlet"]}
    sides |= {f"wall {k}": wall[2 * k : 2 * k + 2] for k in range(10)}
    found = node_groups(data_of(changed(mesh, sides=sides)))
    assert found.max() == 1112
    assert found[mesh.blocks[0][0, 0]] == 103


# Gmsh files, read back by meshio, by scikit-fem, and by a plain reading of their text.


def sections(text: str) -> dict[str, list[list[str]]]:
    """The sections of a Gmsh file as lists of lines; data sections under their field's name."""
    found = {}
    for name, body in re.findall(r"^\$(\w+)\n(.*?)^\$End\1$", text, re.DOTALL | re.MULTILINE):
        lines = body.splitlines()
        found[lines[1].strip('"') if name.endswith("Data") else name] = lines
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_msh_by_meshio(tmp_path: Path, kind: Cells) -> None:
    found = meshio.gmsh.read(written(tmp_path, "msh", kind))
    np.testing.assert_array_equal(found.points[:, :2], DATA.mesh.points)
    assert [block.type for block in found.cells] == ["line", kind]
    lines, cells = (block.data for block in found.cells)
    check_cells(found.points, cells, kind)
    names = {name: tuple(map(int, tag)) for name, tag in found.field_data.items()}
    assert names == {"left": (1, 1), "right": (2, 1), "bottom": (3, 1), "top": (4, 1), "domain": (5, 2)}
    tags = found.cell_data["gmsh:physical"]
    for side in SIDES:
        check_edges(DATA.mesh.points, lines[tags[0] == names[side][0]], side)
    assert np.all(tags[1] == 5)
    np.testing.assert_array_equal(found.point_data["u"], DATA.u.ravel())
    assert sorted(found.point_data) == ["eta", "u", "xi"]
    entities = found.cell_data["gmsh:geometrical"]
    np.testing.assert_array_equal(entities[0], tags[0])
    np.testing.assert_array_equal(entities[1], 1 + per_cell(DATA.subdomain, kind))


@pytest.mark.parametrize("kind", KINDS)
def test_msh_by_its_text(tmp_path: Path, kind: Cells) -> None:
    text = written(tmp_path, "msh", kind).read_text(encoding="ascii")
    assert text.startswith('$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n5\n1 1 "left"\n')
    assert "float64" not in text
    assert "np." not in text
    found = sections(text)
    assert list(found)[:4] == ["MeshFormat", "PhysicalNames", "Nodes", "Elements"]
    assert list(found)[4:] == ["u", "xi", "eta", "Q_eq", "subdomain"]
    nodes = np.array([line.split() for line in found["Nodes"][1:]], dtype=float)
    assert int(found["Nodes"][0]) == len(nodes) == N_XI * N_ETA
    np.testing.assert_array_equal(nodes[:, 0], np.arange(1, len(nodes) + 1))
    np.testing.assert_array_equal(nodes[:, 1:3], DATA.mesh.points)
    elements = [list(map(int, line.split())) for line in found["Elements"][1:]]
    assert int(found["Elements"][0]) == len(elements)
    assert [e[0] for e in elements] == list(range(1, len(elements) + 1))
    shape, corners = (2, 3) if kind == "triangle" else (3, 4)
    lines = np.array([e for e in elements if e[1] == 1])
    cells = np.array([e for e in elements if e[1] == shape])
    assert len(lines) + len(cells) == len(elements)
    assert cells.shape[1] == 5 + corners
    check_cells(DATA.mesh.points, cells[:, 5:] - 1, kind)
    for number, side in enumerate(SIDES, start=1):
        check_edges(DATA.mesh.points, lines[lines[:, 3] == number][:, 5:] - 1, side)
    for name in ("u", "Q_eq", "subdomain"):
        assert found[name][:8] == ["1", f'"{name}"', "1", "0.0", "3", "0", "1", str(len(found[name]) - 8)]
    u = np.array([line.split() for line in found["u"][8:]], dtype=float)
    np.testing.assert_array_equal(u, np.column_stack([nodes[:, 0], DATA.u.ravel()]))
    assert text.count("$ElementNodeData\n") == 2
    for name, expected in (("Q_eq", DATA.q_eq), ("subdomain", DATA.subdomain)):
        rows = np.array([line.split() for line in found[name][8:]], dtype=float)
        assert rows.shape == (len(cells), 2 + corners)
        np.testing.assert_array_equal(rows[:, 0], cells[:, 0])
        assert np.all(rows[:, 1] == corners)
        np.testing.assert_array_equal(rows[:, 2:].T, np.tile(per_cell(expected, kind), (corners, 1)))


@pytest.mark.parametrize("kind", KINDS)
def test_vectors_are_read_by_meshio(tmp_path: Path, kind: Cells) -> None:
    x = DATA.mesh.x
    data = replace(
        DATA, fields={"velocity": np.stack([x, 2 * x], axis=-1)}, cell_fields={"w": np.dstack([DATA.q_eq] * 3)}
    )
    path = write_mesh(tmp_path / "mesh.msh", data, cells=kind)[0]
    found = meshio.gmsh.read(path)
    np.testing.assert_array_equal(
        found.point_data["velocity"], np.column_stack([x.ravel(), 2 * x.ravel(), 0 * x.ravel()])
    )
    of_cells = sections(path.read_text())["w"]
    assert of_cells[7] == str(len(found.cells[1].data))
    assert len(of_cells[8].split()) == 2 + 3 * (4 if kind == "quad" else 3)


# Medit files, read back by meshio.


@pytest.mark.parametrize("kind", KINDS)
def test_medit(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "medit", kind)
    found = meshio.medit.read(path)
    np.testing.assert_array_equal(found.points, DATA.mesh.points)
    assert [block.type for block in found.cells] == ["line", kind]
    edges, labels = found.cells[0].data, found.cell_data["medit:ref"][0]
    for number, side in enumerate(SIDES, start=1):
        check_edges(found.points, edges[labels == number], side)
    check_cells(found.points, found.cells[1].data, kind)
    np.testing.assert_array_equal(found.cell_data["medit:ref"][1], 1 + per_cell(DATA.subdomain, kind))
    inside = found.point_data["medit:ref"].reshape(N_XI, N_ETA)[1:-1, 1:-1]
    assert not inside.any()
    assert np.count_nonzero(found.point_data["medit:ref"]) == N_XI * N_ETA - inside.size
    assert "float64" not in path.read_text(encoding="ascii")


# SU2 files, read back by meshio and by a plain reading of their text.


@pytest.mark.parametrize("kind", KINDS)
def test_su2(tmp_path: Path, kind: Cells) -> None:
    text = written(tmp_path, "su2", kind).read_text(encoding="ascii")
    found = meshio.su2.read(tmp_path / "mesh.su2")
    np.testing.assert_array_equal(found.points, DATA.mesh.points)
    cells = next(block.data for block in found.cells if block.type == kind)
    check_cells(found.points, cells, kind)
    markers = dict(re.findall(r"^MARKER_TAG= (\w+)\nMARKER_ELEMS= (\d+)$", text, re.MULTILINE))
    assert {side: int(count) for side, count in markers.items()} == EDGES
    for side in SIDES:
        body = text.split(f"MARKER_TAG= {side}\n")[1].split("\n", 1)[1].split("MARKER_TAG")[0]
        rows = np.array([line.split() for line in body.splitlines()], dtype=int)
        assert np.all(rows[:, 0] == 3)
        check_edges(DATA.mesh.points, rows[:, 1:], side)
    assert text.startswith("NDIME= 2\nNELEM= ")
    assert "float64" not in text


# VTS files: the text itself, since meshio reads no structured grids; VTK and ParaView read them in tests/solvers.


NUMBERS = {"Float64": "<f8", "Int32": "<i4"}


def arrays_of(section: ET.Element | None) -> dict[str, np.ndarray]:
    """The arrays of a section; each is the count of its bytes in 64 bits, and the bytes."""
    assert section is not None
    found = {}
    for array in section:
        data = base64.b64decode(array.text or "")
        assert int.from_bytes(data[:8], "little") == len(data) - 8
        found[array.attrib["Name"]] = np.frombuffer(data[8:], NUMBERS[array.attrib["type"]])
    return found


def test_rows_run_along_xi(tmp_path: Path) -> None:
    root = ET.parse(written(tmp_path, "vts", "quad")).getroot()
    assert root.attrib["type"] == "StructuredGrid"
    grid = root.find("StructuredGrid")
    piece = root.find("StructuredGrid/Piece")
    extent = f"0 {N_XI - 1} 0 {N_ETA - 1} 0 0"
    assert (grid.attrib["WholeExtent"], piece.attrib["Extent"]) == (extent, extent)
    points = arrays_of(piece.find("Points"))["Points"].reshape(N_ETA, N_XI, 3)
    np.testing.assert_array_equal(points[:, :, 0], DATA.mesh.x.T)
    np.testing.assert_array_equal(points[:, :, 1], DATA.mesh.y.T)
    assert np.all(points[:, :, 2] == 0)
    nodes, cells = arrays_of(piece.find("PointData")), arrays_of(piece.find("CellData"))
    xi, eta = DATA.computational
    assert DATA.u is not None
    for name, values in {"u": DATA.u, "xi": xi, "eta": eta}.items():
        np.testing.assert_array_equal(nodes[name].reshape(N_ETA, N_XI), values.T)
    for name, values in {"Q_eq": DATA.q_eq, "subdomain": DATA.subdomain}.items():
        np.testing.assert_array_equal(cells[name].reshape(N_ETA - 1, N_XI - 1), values.T)
    assert (sorted(nodes), sorted(cells)) == (["eta", "u", "xi"], ["Q_eq", "subdomain"])


def test_vectors_follow_their_points(tmp_path: Path) -> None:
    x = DATA.mesh.x
    data = replace(DATA, fields={"v": np.stack([x, 2 * x], axis=-1)}, cell_fields={"rho": DATA.q_eq})
    piece = ET.parse(write_mesh(tmp_path / "mesh.vts", data)[0]).getroot().find("StructuredGrid/Piece")
    vectors = arrays_of(piece.find("PointData"))["v"].reshape(N_ETA, N_XI, 3)
    np.testing.assert_array_equal(vectors, np.stack([x.T, 2 * x.T, 0 * x.T], axis=-1))
    np.testing.assert_array_equal(arrays_of(piece.find("CellData"))["rho"].reshape(N_ETA - 1, N_XI - 1), DATA.q_eq.T)


WITHOUT_DATA = {"medit", "su2", "abaqus", "p3d", "foam", "hohqmesh", "re2", "nmsh", "specfem"}


@pytest.mark.parametrize("name", FORMATS)
def test_data_are_kept_where_a_format_has_a_place_and_the_callers_stay_as_they_are(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    given = [DATA.mesh.x, DATA.mesh.y, DATA.mesh.cells, DATA.u, DATA.q_eq, DATA.subdomain]
    before = [np.array(values) for values in given]
    path = tmp_path / "mesh.of_another_name"
    assert write_mesh(path, DATA, format=name) == (path,)
    assert [*tmp_path.iterdir()] == [path]
    assert capfd.readouterr() == ("", "")
    assert all(np.array_equal(now, then) for now, then in zip(given, before, strict=True))
    files = [path.read_bytes()]
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            files += [part for one in archive.namelist() for part in (one.encode(), archive.read(one))]
    assert any(b"q_eq" in content.lower() for content in files) == (name not in WITHOUT_DATA)
