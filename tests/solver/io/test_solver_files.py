"""OpenFOAM meshes: the rules of its format, read back from the text, and the files in a zip and in a case."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest

from block_cases import data_of, in_blocks, l_shape
from equimesh.io.solver_files import (
    foam_files,
    integer_rows,
    neutral_map,
    plane_faces,
    plot3d_text,
    quoted,
    with_time,
    words,
)
from equimesh.io.write import Cells, write_mesh
from equimesh.meshes.cell_edges import joins_of
from equimesh.meshes.interfaces import contacts
from equimesh.meshes.mesh import SIDES, Grid, Mesh
from solver.io.files import DATA, KINDS, areas, check_edges, written
from solver.quality.handmade import wavy

NAMES = ["points", "faces", "owner", "neighbour", "boundary"]
NUMBER = re.compile(r"-?[\d.]+(?:e-?\d+)?")


def rows_of(text: str) -> list[list[float]]:
    """The entries of a list, without the number of corners before a face."""
    head, _, body = text.partition("\n(\n")
    rows = [[float(q) for q in NUMBER.findall(line.partition("(")[2] or line)] for line in body.splitlines()[:-1]]
    assert int(head.splitlines()[-1]) == len(rows)
    return rows


class Read:
    """A mesh as OpenFOAM sees it: points in space, faces, the cells on both sides, patches."""

    def __init__(self, files: dict[str, str]) -> None:
        self.points = np.array(rows_of(files["points"]))
        self.faces = [np.array(row, dtype=int) for row in rows_of(files["faces"])]
        self.owner, self.neighbour = (np.array(rows_of(files[n]), dtype=int)[:, 0] for n in ("owner", "neighbour"))
        pattern = r"(\w+)\n\{\n    type (\w+);\n    nFaces (\d+);\n    startFace (\d+);\n\}"
        self.patches = [(n, t, int(k), int(s)) for n, t, k, s in re.findall(pattern, files["boundary"])]

    def area(self, face: np.ndarray) -> np.ndarray:
        """The area vector of a plane face."""
        at = self.points[face]
        return 0.5 * np.sum(np.cross(at, np.roll(at, -1, axis=0)), axis=0)


def read(kind: Cells) -> tuple[Read, np.ndarray]:
    cells = DATA.triangles() if kind == "triangle" else DATA.mesh.cells
    return Read(foam_files(DATA.mesh.points, cells, DATA.mesh.sides)), cells


@pytest.mark.parametrize("kind", KINDS)
class TestRules:
    def test_faces_close_every_cell_and_leave_their_owner(self, kind: Cells) -> None:
        found, cells = read(kind)
        inner, sums, volumes = len(found.neighbour), np.zeros((len(cells), 3)), np.zeros(len(cells))
        for number, face in enumerate(found.faces):
            area, middle = found.area(face), found.points[face].mean(axis=0)
            assert area @ (middle - found.points[self.corners(found, cells, found.owner[number])].mean(axis=0)) > 0
            sums[found.owner[number]] += area
            volumes[found.owner[number]] += area @ middle / 3
            if number < inner:
                sums[found.neighbour[number]] -= area
                volumes[found.neighbour[number]] -= area @ middle / 3
        assert np.abs(sums).max() < 1e-14
        height = found.points[-1, 2]
        assert height == pytest.approx(len(cells) ** -0.5, rel=1e-12)  # the mean size of a cell: the area is 1
        np.testing.assert_allclose(volumes, areas(DATA.mesh.points, cells) * height, rtol=1e-12)

    @staticmethod
    def corners(found: Read, cells: np.ndarray, number: int) -> np.ndarray:
        return np.concatenate([cells[number], cells[number] + len(found.points) // 2])

    def test_internal_faces_are_in_the_order_of_owner_and_neighbour(self, kind: Cells) -> None:
        found, cells = read(kind)
        pairs = list(zip(found.owner.tolist(), found.neighbour.tolist(), strict=False))
        assert pairs == sorted(pairs)
        assert len({*pairs}) == len(pairs)
        assert np.all(found.neighbour > found.owner[: len(pairs)])
        assert len(found.owner) == len(found.faces) == len(pairs) + sum(patch[2] for patch in found.patches)
        assert 2 * len(pairs) + sum(map(len, DATA.mesh.sides.values())) == cells.size

    def test_patches_are_the_sides_and_the_plane(self, kind: Cells) -> None:
        found, _ = read(kind)
        assert [patch[:2] for patch in found.patches] == [
            *((side, "patch") for side in SIDES),
            ("frontAndBack", "empty"),
        ]
        start = len(found.neighbour)
        for name, _, count, first in found.patches:
            assert first == start
            start += count
            faces = found.faces[first:start]
            if name == "frontAndBack":
                assert all(np.ptp(found.points[face][:, 2]) == 0 for face in faces)
                continue
            edges = np.array([face[:2] for face in faces])
            np.testing.assert_array_equal(edges, DATA.mesh.sides[name])
            check_edges(DATA.mesh.points, edges, name)
            assert all((face == [i, j, j + 35, i + 35]).all() for face, (i, j) in zip(faces, edges, strict=True))
        assert start == len(found.faces)

    def test_points_are_exact_and_twins_are_above_each_other(self, kind: Cells) -> None:
        found, _ = read(kind)
        below, above = found.points[:35], found.points[35:]
        np.testing.assert_array_equal(below[:, :2], DATA.mesh.points)
        np.testing.assert_array_equal(above[:, :2], DATA.mesh.points)
        assert np.all(below[:, 2] == 0)

    def test_a_zip_and_a_case_hold_the_same_files(self, tmp_path: Path, kind: Cells) -> None:
        with zipfile.ZipFile(written(tmp_path, "foam", kind)) as archive:
            contents = {name: archive.read(name) for name in archive.namelist()}
        assert [*contents] == [f"constant/polyMesh/{name}" for name in NAMES]
        case = tmp_path / "case"
        (case / "constant" / "polyMesh").mkdir(parents=True)
        (case / "constant" / "polyMesh" / "blockMeshDict").write_text("mine")
        files = write_mesh(case, DATA, cells=kind)
        assert files == write_mesh(case, DATA, cells=kind, format="foam")
        assert [path.relative_to(case).as_posix() for path in files] == [*contents]
        assert {name: (case / name).read_bytes() for name in contents} == contents
        assert sorted(p.name for p in (case / "constant" / "polyMesh").iterdir()) == sorted([*NAMES, "blockMeshDict"])


def test_the_head_counts_points_cells_and_faces() -> None:
    files = foam_files(DATA.mesh.points, DATA.mesh.cells, DATA.mesh.sides)
    # 24 cells: 38 internal edges, 20 of the sides, and 48 faces of the plane
    assert 'note "nPoints:70  nCells:24  nFaces:106  nInternalFaces:38";' in files["owner"]
    for name, kind in (("points", "vectorField"), ("faces", "faceList"), ("boundary", "polyBoundaryMesh")):
        assert files[name].startswith(f"FoamFile\n{{\n    version 2.0;\n    format ascii;\n    class {kind};\n")


def test_two_cells_share_one_face() -> None:
    cells = np.array([[0, 2, 3, 1], [2, 4, 5, 3]])
    sides = {"left": [[1, 0]], "right": [[4, 5]], "bottom": [[0, 2], [2, 4]], "top": [[5, 3], [3, 1]]}
    faces = plane_faces(cells, {name: np.array(edges) for name, edges in sides.items()})
    assert faces.edges.tolist() == [[2, 3], [1, 0], [4, 5], [0, 2], [2, 4], [5, 3], [3, 1]]
    assert faces.owner.tolist() == [0, 0, 1, 0, 1, 1, 0]
    assert faces.neighbour.tolist() == [1]


class TestJoins:
    SQUARE = np.arange(20).reshape(5, 4)

    def files(self) -> dict[str, str]:
        mesh = Mesh.uniform(Grid(n_xi=5, n_eta=4))
        ties = np.column_stack([self.SQUARE[-1], self.SQUARE[0]])
        return foam_files(mesh.points, mesh.cells, mesh.sides, joins_of(mesh.points, mesh.sides, ties))

    def test_both_sides_are_cyclic_patches_that_name_each_other(self) -> None:
        boundary = self.files()["boundary"]
        for name, other, way in (("left", "right", "1.0"), ("right", "left", "-1.0")):
            patch = boundary.partition(f"{name}\n{{")[2].partition("}")[0]
            assert "type cyclic;" in patch
            assert f"neighbourPatch {other};" in patch
            assert f"separationVector ({way} " in patch
        assert "type patch;" in boundary.partition("bottom\n{")[2].partition("}")[0]

    def test_faces_are_in_one_order_and_go_around_in_opposite_directions_from_one_corner(self) -> None:
        found = rows_of(self.files()["faces"])
        inner = 3 * 4 + 2 * 4 + 1 - 4
        left, right = (np.array(found[start : start + 3], dtype=int) for start in (17, 20))
        assert inner == 17
        assert np.array_equal(right[:, 0], left[:, 0] + 16)
        assert np.array_equal(right[:, ::-1][:, :3], left[:, 1:] + 16)


# Rows of a text file from tables of integers.


def test_every_row_has_its_numbers_in_the_form() -> None:
    table = np.array([[1, -2, 3], [40, 5, 2**40]])
    assert integer_rows("3(%d %d %d)", table) == ["3(1 -2 3)", f"3(40 5 {2**40})"]
    assert integer_rows("%d", np.empty((0, 1), dtype=np.int64)) == []


# Plot3D grids and their neutral map files, and what VTK's rules say of them.


def test_the_grid_has_its_blocks_one_after_the_other_with_i_first() -> None:
    x, y = np.meshgrid([0.0, 1.0, 2.5], [0.0, 0.1], indexing="ij")
    text = plot3d_text([(x, y), (x + 5, y)])
    assert text.splitlines()[:3] == ["2", "3 2 1", "3 2 1"]
    numbers = np.array(text.split()[7:], dtype=float).reshape(2, 3, 2, 3)
    assert numbers[0, 0].tolist() == [[0.0, 1.0, 2.5], [0.0, 1.0, 2.5]]
    assert numbers[1, 1].tolist() == [[0.0] * 3, [0.1] * 3]
    assert not numbers[:, 2].any()


def test_the_map_names_the_faces_of_interfaces_and_sides() -> None:
    mesh = l_shape(3)
    rows = neutral_map([(3, 3)] * 3, contacts(mesh)).splitlines()
    assert rows[1:5] == ["3", "1 3 3 1", "2 3 3 1", "3 3 3 1"]
    assert "'ONE_TO_ONE' 1 4 1 3 1 1 2 3 1 3 1 1 FALSE" in rows
    assert "'ONE_TO_ONE' 1 6 1 1 1 3 3 5 1 1 1 3 FALSE" in rows
    assert "'outlet' 2 4 1 3 1 1" in rows


def test_the_ranges_of_a_turned_block_fall_and_are_swapped() -> None:
    mesh = in_blocks(wavy(), column=3).mesh
    (row,) = [row for row in neutral_map([(4, 9), (9, 10)], contacts(mesh)).splitlines() if "ONE" in row]
    found = re.fullmatch(r"'ONE_TO_ONE' 1 4 1 9 1 1 2 ([56]) 1 1 (\d) (\d) TRUE", row)
    assert found
    first, last = int(found[2]), int(found[3])
    there = {"5": mesh.blocks[1][:, 0], "6": mesh.blocks[1][:, -1]}[found[1]]
    assert np.array_equal(there[:: 1 if last > first else -1], mesh.blocks[0][-1])


def test_files_of_blocks_and_of_a_grid(tmp_path: Path) -> None:
    assert write_mesh(tmp_path / "mesh.p3d", data_of(l_shape())) == (tmp_path / "mesh.p3d", tmp_path / "mesh.nmf")
    assert write_mesh(tmp_path / "mesh.p3d.zip", DATA) == (tmp_path / "mesh.p3d.zip",)
    with zipfile.ZipFile(tmp_path / "mesh.p3d.zip") as archive:
        assert archive.namelist() == ["mesh.xyz", "mesh.nmf"]
        assert archive.read("mesh.xyz").split()[:4] == [b"1", b"7", b"5", b"1"]
        assert b"'left' 1 3 1 5 1 1" in archive.read("mesh.nmf")


# Names of sides in formats that take words only.


def test_words_are_kept_and_others_made_to_words() -> None:
    assert words(["inlet", "the wall", "top.1"]) == {"inlet": "inlet", "the wall": "the_wall", "top.1": "top.1"}
    assert words(["", "ä{}"]) == {"": "side", "ä{}": "___"}


def test_words_differ() -> None:
    found = words(["a b", "a_b", "a;b", "a(b"])
    assert found == {"a b": "a_b_2", "a_b": "a_b", "a;b": "a_b_3", "a(b": "a_b_4"}
    assert words(["frontAndBack"], taken=["frontAndBack"]) == {"frontAndBack": "frontAndBack_2"}


def test_quotes_and_line_ends_leave_names_between_quotes() -> None:
    assert quoted(['the "big" wall', "a b\n"]) == {'the "big" wall': "the _big_ wall", "a b\n": "a b_"}


# The time of an XDMF file; readers of several programs take it in tests/solvers.


TEXT = '<Xdmf Version="3.0"><Domain><Grid Name="Grid"><Geometry/><Topology/></Grid></Domain></Xdmf>'


def test_the_grid_refers_to_one_with_a_time() -> None:
    root = ET.fromstring(with_time(TEXT))
    (grid,) = root.findall("Domain/Grid")
    assert [child.tag for child in grid] == ["Geometry", "Topology", "Information"]
    referred = root.find("." + grid.attrib["Reference"].removeprefix("/Xdmf"))
    assert [child.tag for child in referred] == ["Time", "Geometry", "Topology"]
    assert referred[0].attrib == {"Value": "0"}
    assert ET.fromstring(grid[2].text or "").tag == "nothing"  # meshio reads this text as XML


@pytest.mark.parametrize("text", ["", "<Xdmf/>", '<Grid Name="Grid">'])
def test_a_text_without_a_grid_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="holds no grid"):
        with_time(text)
