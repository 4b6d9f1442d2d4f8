"""SU2 files: our own back again, others with fewer columns, and what broken ones are told."""

from __future__ import annotations

import pytest

from equimesh.io.reading.read import read_bytes
from equimesh.io.solver_files import su2_text
from solver.io.reading.plain import refusal, same, small

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


BROKEN = {
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


@pytest.mark.parametrize("told", BROKEN)
def test_broken_files_are_refused_with_the_place(told: str) -> None:
    assert told in refusal(BROKEN[told], "su2")


def test_the_place_of_a_triangle_is_its_middle() -> None:
    text = SHORT.replace("NELEM= 1\n9 0 1 2 3", "NELEM= 2\n9 0 1 2 3\n5 1 2 3")
    assert "cell 1 of the file near (0.666667, 0.666667) is a triangle" in refusal(text, "su2")


def test_an_empty_file_is_told_what_it_lacks() -> None:
    assert refusal(b"", "su2") == "the SU2 file has no NDIME="
