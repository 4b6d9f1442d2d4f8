"""Writing files: VTK and XDMF read back, formats by name and suffix, and nothing left behind by a failure."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest

import equimesh
from equimesh.errors import InputError
from equimesh.io.write import FORMATS, Cells, write_mesh
from equimesh.meshes.mesh import SIDES
from solver.io.files import CELL_COUNT, DATA, EDGES, KINDS, adapted, check_cells, check_edges, check_mesh, written


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
        with pytest.raises(InputError, match=r"vtu, vtk, vts, vtm, xdmf, msh, medit, su2, p3d, foam, npz") as caught:
            write_mesh(tmp_path / "mesh.vtu", DATA, format=name)
        assert caught.value.field == "format"
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("name", ["mesh", "mesh.stl", "mesh.zip", "vtu"])
    def test_unknown_suffixes(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(
            InputError,
            match=r"\.vtu, \.vtk, \.vts, \.vtm\.zip, .*, \.npz, \.xdmf, \.vtm, \.xyz, \.p3d",
        ):
            write_mesh(tmp_path / name, DATA)

    @pytest.mark.parametrize("name", ["m.vtu", "m.xdmf"])
    def test_folders_that_do_not_exist(self, tmp_path: Path, name: str) -> None:
        path = tmp_path / "none" / name
        with pytest.raises(InputError) as caught:
            write_mesh(path, DATA)
        assert caught.value.field == "path"
        assert str(caught.value) == f"{path}: there is no folder {path.parent}; make it first"

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
    def test_only_io_imports_meshio(self) -> None:
        folder = Path(equimesh.__file__).parent
        importers = [
            p.name for p in folder.rglob("*.py") if re.search(r"^\s*(import|from) meshio", p.read_text(), re.M)
        ]
        assert {*importers} == {"write.py"}

    def test_importing_it_warns_of_nothing(self) -> None:
        code = "import equimesh.io, equimesh.upload, json; print(json.dumps(list(equimesh.io.FORMATS)))"
        done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
        assert json.loads(done.stdout) == list(FORMATS)
        assert done.stderr == ""

    def test_a_mesh_of_sixty_thousand_points(self, tmp_path: Path) -> None:
        data = adapted(300, 200)
        for name, known in FORMATS.items():
            write_mesh(tmp_path / name, data, format=name, cells=known.cells[-1])
        with np.load(io.BytesIO((tmp_path / "npz").read_bytes())) as arrays:
            assert arrays["cells"].shape == (2 * 299 * 199, 3)


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
