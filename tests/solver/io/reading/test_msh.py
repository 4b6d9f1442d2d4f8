"""Gmsh files: our own back again, version 4.1 and binary, and what broken ones are told."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from equimesh.io.reading.read import read_bytes, read_mesh
from equimesh.io.solver_files import gmsh_text
from solver.io.reading.plain import refusal, same, small

# One cell of four nodes that the file numbers 10, 11, 21, 20, its lower edge on the curve 1 of two groups, as Gmsh 4
# writes it; one of the groups has no name. Node 30 is the centre of an arc, which no cell uses.
VERSION_4 = """$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
0 7 "te"
1 1 "wall"
2 5 "fluid"
$EndPhysicalNames
$Entities
1 2 1 0
1 0 0 0 1 7
1 0 0 0 1 0 0 1 1 2 1 -2
2 0 0 0 1 0 0 1 4 2 1 -2
1 0 0 0 1 1 0 1 5 4 1 2 3 4
$EndEntities
$Nodes
2 5 10 30
0 1 0 1
10
0 0 0.25
2 1 0 4
11
30
21
20
1 0 .25
5 5 .25
1 1.5 .25
0 1 .25
$EndNodes
$Elements
4 4 1 4
0 1 15 1
9 10
1 1 1 1
1 10 11
1 2 1 1
2 11 21
2 1 3 1
3 10 11 21 20
$EndElements
"""


def ours() -> str:
    mesh = small()
    return gmsh_text(
        mesh.points, mesh.cells, mesh.sides, subdomain=np.zeros(6, int), point_data={}, cell_data={"q": np.ones(6)}
    )


def test_our_own_file_comes_back_to_the_bit() -> None:
    assert same(read_bytes(ours().encode(), "msh"), small())


def test_version_4_has_groups_by_entities_and_any_numbers() -> None:
    mesh = read_bytes(VERSION_4.encode(), "msh")
    assert mesh.points.tolist() == [[0, 0], [1, 0], [1, 1.5], [0, 1]]
    assert mesh.cells.tolist() == [[0, 1, 2, 3]]
    assert {name: edges.tolist() for name, edges in mesh.sides.items()} == {"wall": [[0, 1]], "group_4": [[1, 2]]}
    assert mesh.places == {"te": 0}


def test_binary_files(tmp_path: Path) -> None:
    mesh = small()
    edges = [("line", edges) for edges in mesh.sides.values()]
    tags = [np.full(len(edges), k) for k, edges in enumerate(mesh.sides.values(), start=1)] + [np.full(6, 5)]
    names = {name: np.array([k, 1]) for k, name in enumerate(mesh.sides, start=1)}
    written = meshio.Mesh(
        np.pad(mesh.points, ((0, 0), (0, 1))),
        [*edges, ("quad", mesh.cells)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data=names,
    )
    meshio.write(tmp_path / "mesh.msh", written, file_format="gmsh22", binary=True)
    assert same(read_mesh(tmp_path / "mesh.msh"), mesh)


BROKEN = {
    "line 21: 'x' is no number, among the nodes": VERSION_4.replace("0 0 0.25", "0 x 0.25"),
    "line 39: '2.5' is no integer": VERSION_4.replace("2 11 21", "2 11 2.5"),
    "the section $Elements does not end": VERSION_4.replace("$EndElements", ""),
    "no section $Nodes": VERSION_4.replace("Nodes\n", "Knots\n"),
    "version '4.0' of the Gmsh format: save the mesh in version 2.2 or 4.1": VERSION_4.replace("4.1 0 8", "4.0 0 8"),
    "node 22, which the file does not have": VERSION_4.replace("3 10 11 21 20", "3 10 11 22 20"),
    "node 11 is in the file twice": VERSION_4.replace("21\n20\n", "11\n20\n"),
    "leaves the plane: node 1 has z = 0.75": VERSION_4.replace("1 0 .25", "1 0 .75"),
    "the blocks of elements are not as many": VERSION_4.replace("4 4 1 4", "3 4 1 4"),
    "a triangle: only quadrilaterals can be adapted": VERSION_4.replace(
        "2 1 3 1\n3 10 11 21 20", "2 1 2 1\n3 10 11 21"
    ),
    "order 1": VERSION_4.replace("2 1 3 1", "2 1 36 1"),
    "the file has no quadrilaterals": VERSION_4.replace("4 4 1 4", "3 3 1 4").replace("2 1 3 1\n3 10 11 21 20\n", ""),
    "8 elements are told, but 16 whole ones follow": ours().replace("$Elements\n16", "$Elements\n8"),
    "no Gmsh file": "NDIME= 2",
}


@pytest.mark.parametrize("told", BROKEN)
def test_broken_files_are_refused_with_the_place(told: str) -> None:
    assert told in refusal(BROKEN[told], "msh")


def test_nodes_of_no_width_and_many_groups_are_refused() -> None:
    head = "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
    nodes = "$Nodes\n1e15 1 1 1\n-8 1 1 1 1 1 1 1 1\n$EndNodes\n$Elements\n0 0 0 0\n$EndElements\n"
    assert "line 5: the section has 1000000000000000 blocks: 100000 are possible" in refusal(
        (head + nodes).encode(), "msh"
    )
    assert "the nodes end too early" in refusal((head + nodes.replace("1e15", "3")).encode(), "msh")
    tags = " ".join(map(str, range(1, 102)))
    entities = f"$Entities\n0 1 0 0\n1 0 0 0 1 0 0 101 {tags} 0\n$EndEntities\n"
    assert "line 6: 101 physical groups of one entity" in refusal((head + entities + nodes).encode(), "msh")


def test_the_line_of_a_section_counts_those_before() -> None:
    data = b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n" + b"$A\n" + b"\n" * 100_000 + b"$EndA\n$Nodes\n"
    assert "line 100006: the section $Nodes does not end" in refusal(data, "msh")


def test_lines_that_change_their_group_without_end_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = "".join(f"{k} 1 2 {k} 1 1 2\n" for k in range(1, 7))
    head = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n$EndNodes\n"
    data = f"{head}$Elements\n7\n{lines}7 3 2 9 1 1 2 3 4\n$EndElements\n".encode()
    assert len(read_bytes(data, "msh").sides) == 6
    monkeypatch.setattr("equimesh.io.reading.msh.MAX_BLOCKS", 5)
    assert "the lines change their group more than 5 times" in refusal(data, "msh")
