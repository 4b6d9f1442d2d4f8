"""Files: each format is read back by another reader, and by a plain reading of its text."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import skfem

import equimesh
from equimesh.errors import InputError
from equimesh.io.npz import load_npz
from equimesh.io.vtu import write_vtu
from equimesh.io.write import FORMATS, Cells, MeshData, write_mesh
from equimesh.meshes.mesh import SIDES, Mesh
from equimesh.upload.samples import read_samples

N_XI, N_ETA = 7, 5
CELL_COUNT = (N_XI - 1) * (N_ETA - 1)
EDGES = {"left": N_ETA - 1, "right": N_ETA - 1, "bottom": N_XI - 1, "top": N_XI - 1}
KINDS: tuple[Cells, ...] = ("quad", "triangle")
READS_TAGS = {"left": (0, 0.0), "right": (0, 1.0), "bottom": (1, 0.0), "top": (1, 1.0)}


def adapted(n_xi: int = N_XI, n_eta: int = N_ETA) -> MeshData:
    """A curved mesh of the unit square with data that tells every node and cell apart."""
    xi, eta = np.meshgrid(np.linspace(0, 1, n_xi), np.linspace(0, 1, n_eta), indexing="ij")
    bump = 0.12 * np.sin(np.pi * xi) * np.sin(np.pi * eta)
    cells = (n_xi - 1, n_eta - 1)
    return MeshData(
        mesh=Mesh(np.sqrt(xi) + bump * (1 - xi), eta**1.5 - bump * eta),
        u=np.cos(5 * xi) + 0.1 * eta,
        q_eq=1 + np.arange(np.prod(cells)).reshape(cells) / 7,
        subdomain=np.arange(np.prod(cells), dtype=np.int64).reshape(cells) // 11,
    )


DATA = adapted()


def per_cell(values: np.ndarray, kind: str) -> np.ndarray:
    return np.repeat(values.ravel(), 2 if kind == "triangle" else 1)


def areas(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Signed areas of polygons."""
    x, y = points[cells, 0], points[cells, 1]
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)


def check_cells(points: np.ndarray, cells: np.ndarray, kind: str) -> None:
    assert cells.shape == ((CELL_COUNT, 4) if kind == "quad" else (2 * CELL_COUNT, 3))
    found = areas(points, cells)
    assert np.all(found > 0)
    assert found.sum() == pytest.approx(1)
    quads = areas(points, DATA.mesh.cells)
    np.testing.assert_allclose(found if kind == "quad" else found.reshape(-1, 2).sum(axis=1), quads, rtol=1e-12)


def check_edges(points: np.ndarray, edges: np.ndarray, side: str) -> None:
    """The edges lie on the side, join up to all of it, and have the domain on their left."""
    axis, at = READS_TAGS[side]
    assert edges.shape == (EDGES[side], 2)
    assert np.all(points[edges][:, :, axis] == at)
    direction = points[edges[:, 1]] - points[edges[:, 0]]
    assert np.abs(direction[:, 1 - axis]).sum() == pytest.approx(1)
    inwards = np.array([-direction[:, 1], direction[:, 0]])[axis]
    assert np.all(inwards * (1 if at == 0 else -1) > 0)


def check_mesh(found: Any, kind: str, *, dimension: int) -> None:
    """What meshio read against what was written."""
    assert found.points.shape == (N_XI * N_ETA, dimension)
    np.testing.assert_array_equal(found.points[:, :2], DATA.mesh.points)
    assert np.all(found.points[:, 2:] == 0)
    assert [block.type for block in found.cells] == [kind]
    check_cells(found.points, found.cells[0].data, kind)
    xi, eta = DATA.computational
    assert sorted(found.point_data) == ["eta", "u", "xi"]
    for name, values in (("u", DATA.u), ("xi", xi), ("eta", eta)):
        np.testing.assert_array_equal(np.ravel(found.point_data[name]), values.ravel())
    assert sorted(found.cell_data) == ["Q_eq", "subdomain"]
    np.testing.assert_array_equal(np.ravel(found.cell_data["Q_eq"][0]), per_cell(DATA.q_eq, kind))
    np.testing.assert_array_equal(np.ravel(found.cell_data["subdomain"][0]), per_cell(DATA.subdomain, kind))
    for side, (axis, at) in READS_TAGS.items():  # the sides can be found by xi and eta
        nodes = np.unique(DATA.mesh.sides[side])
        np.testing.assert_array_equal(np.flatnonzero(np.ravel(found.point_data[("xi", "eta")[axis]]) == at), nodes)


def sections(text: str) -> dict[str, list[list[str]]]:
    """The sections of a Gmsh file as lists of lines; data sections under their field's name."""
    found = {}
    for name, body in re.findall(r"^\$(\w+)\n(.*?)^\$End\1$", text, re.DOTALL | re.MULTILINE):
        lines = body.splitlines()
        found[lines[1].strip('"') if name.endswith("Data") else name] = lines
    return found


@pytest.mark.parametrize("kind", KINDS)
class TestReadBack:
    def write(self, folder: Path, name: str, kind: Cells) -> Path:
        path = folder / f"mesh{FORMATS[name].suffix}"
        assert write_mesh(path, DATA, format=name, cells=kind) == (path,)
        return path

    def test_vtu(self, tmp_path: Path, kind: Cells) -> None:
        path = self.write(tmp_path, "vtu", kind)
        check_mesh(meshio.vtu.read(path), kind, dimension=3)
        text = path.read_text()
        count = CELL_COUNT * (2 if kind == "triangle" else 1)
        assert f'NumberOfPoints="{N_XI * N_ETA}" NumberOfCells="{count}"' in text
        assert 'type="UnstructuredGrid"' in text
        assert re.findall(r'type="(\w+)" Name="(?:connectivity|offsets|types)"', text) == ["Int32", "Int32", "UInt8"]
        again = read_samples(path.read_bytes(), "mesh.vtu")  # our own reader of points
        np.testing.assert_array_equal(again.values, DATA.u.ravel())

    def test_vtu_in_pieces(self, tmp_path: Path, kind: Cells, monkeypatch: pytest.MonkeyPatch) -> None:
        """A file is the same however many pieces it is written in, and whatever the last one's size."""
        whole = self.write(tmp_path, "vtu", kind).read_bytes()
        monkeypatch.setattr("equimesh.io.vtu.PIECE", 33)
        assert self.write(tmp_path, "vtu", kind).read_bytes() == whole
        values = {f"<{n}>": np.arange(n, dtype=">f8") for n in range(1, 9)}
        for name, array in values.items():
            points, cells = np.zeros((array.size, 2)), np.zeros((1, 4), dtype=np.int64)
            write_vtu(tmp_path / "small.vtu", points, cells, point_data={name: array}, cell_data={})
            found = meshio.vtu.read(tmp_path / "small.vtu").point_data
            assert {key: value.tolist() for key, value in found.items()} == {name: array.tolist()}

    def test_vtk(self, tmp_path: Path, kind: Cells) -> None:
        path = self.write(tmp_path, "vtk", kind)
        check_mesh(meshio.vtk.read(path), kind, dimension=3)
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
        path = self.write(tmp_path, "xdmf", kind)
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
        assert '<Grid Name="Grid">' in text
        assert 'GeometryType="XY"' in text
        assert f'TopologyType="{"Triangle" if kind == "triangle" else "Quadrilateral"}"' in text
        for stem, part in (("mesh", text), ("facets", (tmp_path / "facets.xdmf").read_text())):
            with h5py.File(tmp_path / f"{stem}.h5") as heavy:
                pointers = re.findall(r'Dimensions="([\d ]+)"[^>]*>([^<]+)<', part)
                assert len(pointers) == (7 if stem == "mesh" else 3)
                for dimensions, pointer in pointers:
                    file, _, dataset = pointer.partition(":")
                    assert file == f"{stem}.h5"
                    assert heavy[dataset].shape == tuple(map(int, dimensions.split()))
        with h5py.File(tmp_path / "mesh.h5") as heavy:
            np.testing.assert_array_equal(heavy["data0"][:], DATA.mesh.points)

    def test_msh_by_meshio(self, tmp_path: Path, kind: Cells) -> None:
        found = meshio.gmsh.read(self.write(tmp_path, "msh", kind))
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

    def test_msh_by_scikit_fem(self, tmp_path: Path, kind: Cells) -> None:
        path = self.write(tmp_path, "msh", kind)
        found = (skfem.MeshTri if kind == "triangle" else skfem.MeshQuad).load(path)
        assert found.p.shape == (2, N_XI * N_ETA)
        assert set(SIDES) <= set(found.boundaries)
        for side, (axis, at) in READS_TAGS.items():
            middles = found.p[:, found.facets[:, found.boundaries[side]]].mean(axis=1)
            assert middles.shape[1] == EDGES[side]
            np.testing.assert_array_equal(middles[axis], at)

    def test_msh_by_its_text(self, tmp_path: Path, kind: Cells) -> None:
        text = self.write(tmp_path, "msh", kind).read_text(encoding="ascii")
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

    def test_medit(self, tmp_path: Path, kind: Cells) -> None:
        path = self.write(tmp_path, "medit", kind)
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

    def test_su2(self, tmp_path: Path, kind: Cells) -> None:
        text = self.write(tmp_path, "su2", kind).read_text(encoding="ascii")
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

    def test_npz(self, tmp_path: Path, kind: Cells) -> None:
        path = self.write(tmp_path, "npz", kind)
        with np.load(path, allow_pickle=False) as arrays:
            assert set(arrays) == {"x", "y", "u", "cells", "q_eq", "subdomain", *SIDES}
            check_cells(DATA.mesh.points, arrays["cells"], kind)
            np.testing.assert_array_equal(arrays["q_eq"], per_cell(DATA.q_eq, kind))
            np.testing.assert_array_equal(arrays["subdomain"], per_cell(DATA.subdomain, kind))
            for side in SIDES:
                check_edges(DATA.mesh.points, arrays[side], side)
        again = load_npz(path)
        pairs = [(again.mesh.x, DATA.mesh.x), (again.mesh.y, DATA.mesh.y)]
        pairs += [(getattr(again, name), getattr(DATA, name)) for name in ("u", "q_eq", "subdomain")]
        for found, expected in pairs:
            assert found.dtype == expected.dtype
            assert found.tobytes() == expected.tobytes()
            assert found.shape == expected.shape

    def test_the_same_mesh_gives_the_same_bytes(self, tmp_path: Path, kind: Cells) -> None:
        def contents(name: str) -> bytes:
            return self.write(tmp_path, name, kind).read_bytes()

        first = {name: contents(name) for name in FORMATS}
        time.sleep(2.1)  # beyond the two seconds of a zip's clock
        assert {name: contents(name) for name in FORMATS} == first

    def test_unpacked_xdmf(self, tmp_path: Path, kind: Cells) -> None:
        names = ["run.xdmf", "run.h5", "run_facets.xdmf", "run_facets.h5"]
        written = write_mesh(tmp_path / "run.xdmf", DATA, cells=kind)
        assert written[0].name == "run.xdmf"
        assert sorted(p.name for p in written) == sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
        check_mesh(meshio.xdmf.read(tmp_path / "run.xdmf"), kind, dimension=2)
        assert meshio.xdmf.read(tmp_path / "run_facets.xdmf").cells_dict["line"].shape == (sum(EDGES.values()), 2)


class TestTriangles:
    @staticmethod
    def data(*corners: tuple[float, float]) -> MeshData:
        """One cell of interest, the first of a mesh, with the given corners counter-clockwise."""
        x, y = (a.copy() for a in np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij"))
        for (i, j), (px, py) in zip(((0, 0), (1, 0), (1, 1), (0, 1)), corners, strict=True):
            x[i, j], y[i, j] = px, py
        return MeshData(mesh=Mesh(x, y), u=x, q_eq=np.ones((3, 3)), subdomain=np.zeros((3, 3), dtype=np.int64))

    def first(self, *corners: tuple[float, float]) -> list[list[int]]:
        return [sorted(t) for t in self.data(*corners).triangles()[:2].tolist()]

    def test_the_larger_smallest_angle_wins(self) -> None:
        main, other = [[0, 4, 5], [0, 1, 5]], [[0, 1, 4], [1, 4, 5]]
        assert self.first((0, 0), (1, 0), (1.6, 1.6), (0, 1)) == other
        assert self.first((0.4, 0.4), (1, -0.5), (1, 1), (-0.5, 1)) == main

    def test_an_even_cell_is_cut_from_its_first_corner(self) -> None:
        assert self.first((0, 0), (1, 0), (1, 1), (0, 1)) == [[0, 4, 5], [0, 1, 5]]
        data = adapted(18, 18)
        xi, eta = data.computational
        turned = Mesh(np.cos(0.3) * xi - np.sin(0.3) * eta, np.sin(0.3) * xi + np.cos(0.3) * eta)  # even up to rounding
        even = MeshData(mesh=turned, u=data.u, q_eq=data.q_eq, subdomain=data.subdomain)
        first = even.triangles().reshape(-1, 2, 3)[:, :, 0]
        np.testing.assert_array_equal(first, np.repeat(turned.cells[:, :1], 2, axis=1))

    def test_a_dented_cell_keeps_both_triangles_positive(self) -> None:
        for dent in range(4):
            corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
            x, y = corners[dent]
            corners[dent] = (x + 0.6 * (1 - 2 * x), y + 0.6 * (1 - 2 * y))  # beyond the middle
            data = self.data(*corners)
            assert np.all(areas(data.mesh.points, data.triangles()[:2]) > 0)

    def test_two_for_each_cell_in_order(self) -> None:
        pairs = DATA.triangles().reshape(-1, 6)
        for pair, quad in zip(pairs, DATA.mesh.cells, strict=True):
            assert set(pair) == set(quad)


class TestRefusals:
    @pytest.mark.parametrize("name", ["stl", "", "VTU", "xdmf.zip"])
    def test_unknown_formats(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match=r"vtu, vtk, xdmf, msh, medit, su2, npz") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA, format=name)
        assert caught.value.field == "format"
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["mesh", "mesh.stl", "mesh.zip", "vtu"])
    def test_unknown_suffixes(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match=r"\.vtu, \.vtk, \.xdmf\.zip, \.msh, \.mesh, \.su2, \.npz, \.xdmf"):
            write_mesh(tmp_path / name, DATA)

    @pytest.mark.parametrize("name", ["m.vtu", "m.xdmf"])
    def test_folders_that_do_not_exist(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "none" / name
        with pytest.raises(InputError) as caught:
            write_mesh(path, DATA)
        assert caught.value.field == "path"
        assert str(caught.value) == f"{path}: there is no folder {path.parent}; make it first"

    def test_unknown_cells(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="quad or triangle") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA, cells="hexagon")  # type: ignore[arg-type]
        assert caught.value.field == "cells"

    def test_wrong_shapes(self) -> None:
        with pytest.raises(InputError, match=r"q_eq has shape \(7, 5\), this mesh needs \(6, 4\)"):
            MeshData(mesh=DATA.mesh, u=DATA.u, q_eq=DATA.u, subdomain=DATA.subdomain)

    def test_files_that_are_no_result(self, tmp_path: Path) -> None:
        path = tmp_path / "mesh.npz"
        for content in (b"", b"text", b"PK\x03\x04 broken"):
            path.write_bytes(content)
            with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
                load_npz(path)
        for arrays in ({"x": np.ones(3)}, {n: np.ones((4, 4)) for n in ("x", "y", "u", "cells", "q_eq", "subdomain")}):
            np.savez(path, **arrays)
            with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
                load_npz(path)
        np.savez(path, x=np.array([{}], dtype=object))
        with pytest.raises(InputError, match=r"mesh\.npz is not a mesh"):
            load_npz(path)
        with pytest.raises(FileNotFoundError):
            load_npz(tmp_path / "missing.npz")


class TestDisk:
    def test_the_suffix_gives_the_format(self, tmp_path: Path) -> None:
        for name, known in FORMATS.items():
            by_suffix, by_name = tmp_path / f"a{known.suffix}", tmp_path / f"a-{name}.part"
            write_mesh(by_suffix, DATA)
            write_mesh(str(by_name), DATA, format=name)
            assert by_suffix.read_bytes() == by_name.read_bytes()

    def test_a_zip_may_have_the_name_of_its_content(self, tmp_path: Path) -> None:
        write_mesh(tmp_path / "mesh.xdmf", DATA, format="xdmf")
        with zipfile.ZipFile(tmp_path / "mesh.xdmf") as archive:
            assert archive.read("mesh.xdmf").startswith(b"<Xdmf")

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

    def test_a_file_is_readable_as_any_new_file(self, tmp_path: Path) -> None:
        (tmp_path / "plain").touch()
        write_mesh(tmp_path / "mesh.vtu", DATA)
        assert (tmp_path / "mesh.vtu").stat().st_mode == (tmp_path / "plain").stat().st_mode

    def test_writing_prints_nothing(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        for name in FORMATS:
            write_mesh(tmp_path / "mesh", DATA, format=name)
        assert capfd.readouterr() == ("", "")

    def test_the_callers_data_is_not_changed(self, tmp_path: Path) -> None:
        data = adapted()
        for name in FORMATS:
            write_mesh(tmp_path / "mesh", data, format=name)
        np.testing.assert_array_equal(data.mesh.x, DATA.mesh.x)
        np.testing.assert_array_equal(data.q_eq, DATA.q_eq)


class TestFormats:
    def test_each_is_described(self) -> None:
        assert list(FORMATS) == ["vtu", "vtk", "xdmf", "msh", "medit", "su2", "npz"]
        for name, known in FORMATS.items():
            assert known.name == name
            assert known.suffix.startswith(".")
            assert re.fullmatch(r"[a-z]+/[a-z0-9.+-]+", known.media_type)
            assert len(known.description) > 20
        assert len({known.media_type for known in FORMATS.values()}) == len(FORMATS)

    def test_only_io_imports_meshio(self) -> None:
        folder = Path(equimesh.__file__).parent
        importers = [
            p.name for p in folder.rglob("*.py") if re.search(r"^\s*(import|from) meshio", p.read_text(), re.M)
        ]
        assert importers == ["write.py"]

    def test_importing_it_warns_of_nothing(self) -> None:
        code = "import equimesh.io, equimesh.upload, json; print(json.dumps(list(equimesh.io.FORMATS)))"
        done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
        assert json.loads(done.stdout) == list(FORMATS)
        assert done.stderr == ""

    def test_a_mesh_of_sixty_thousand_points(self, tmp_path: Path) -> None:
        data = adapted(300, 200)
        for name in FORMATS:
            write_mesh(tmp_path / name, data, format=name, cells="triangle")
        with np.load(io.BytesIO((tmp_path / "npz").read_bytes())) as arrays:
            assert arrays["cells"].shape == (2 * 299 * 199, 3)
