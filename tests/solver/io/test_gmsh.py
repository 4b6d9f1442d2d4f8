"""Gmsh files, read back by meshio, by scikit-fem, and by a plain reading of their text."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import skfem

from equimesh.io.write import Cells, write_mesh
from equimesh.meshes.mesh import SIDES
from solver.io.files import DATA, EDGES, KINDS, N_ETA, N_XI, READS_TAGS, check_cells, check_edges, per_cell, written


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
def test_msh_by_scikit_fem(tmp_path: Path, kind: Cells) -> None:
    path = written(tmp_path, "msh", kind)
    found = (skfem.MeshTri if kind == "triangle" else skfem.MeshQuad).load(path)
    assert found.p.shape == (2, N_XI * N_ETA)
    assert set(SIDES) <= set(found.boundaries)
    for side, (axis, at) in READS_TAGS.items():
        middles = found.p[:, found.facets[:, found.boundaries[side]]].mean(axis=1)
        assert middles.shape[1] == EDGES[side]
        np.testing.assert_array_equal(middles[axis], at)


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
