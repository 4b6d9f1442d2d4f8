"""blockMeshDict: the description of a step with an arc, and what is refused, by its line."""

from __future__ import annotations

import re
import time

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading import block_mesh_dict
from equimesh.io.reading.block_mesh_dict import (
    Hex,
    Layer,
    block_entry,
    edge_entries,
    layer_of,
    read_block_mesh_dict,
    sides_and_joins,
    vertex_of,
)
from equimesh.io.reading.foam import Word, parse

# Two blocks, the right one with a bent lid; layers are across z.
TEXT = """FoamFile { format ascii; class dictionary; }
scale 2;
vertices
(
    (0 0 0) (1 0 0) (1 1 0) (0 1 0)
    (0 0 .1) (1 0 .1) (1 1 .1) (0 1 .1)
    name e (2 0 0) name f (2 1 0) (2 0 .1) (2 1 .1)
);
grow ( (1 4 2) (3 4 1) );
blocks
(
    hex (0 1 2 3 4 5 6 7) (10 20 1) simpleGrading (2 $grow 1)
    hex (1 e f 2 5 10 11 6) fluid (30 20 1) edgeGrading (1 1 1 1 $grow -4 -4 $grow 1 1 1 1)
);
edges
(
    arc 2 f (1.5 1.5 0)
    arc 6 11 (1.5 1.5 .1)
    line 0 1
);
boundary
(
    inlet { type patch; faces ((0 4 7 3)); }
    outlet { type patch; faces ((1 1)); }
    walls { type wall; faces ((0 1 5 4) (1 e 10 5) (3 7 6 2) (2 6 11 f)); }
    frontAndBack { type empty; faces ((0 3 2 1) (4 5 6 7) (1 2 f e) (5 10 11 6)); }
);
mergePatchPairs ( );
"""
GROW = [[1, 4, 2], [3, 4, 1]]


def test_vertices_blocks_edges_and_sides() -> None:
    found = read_block_mesh_dict(TEXT)
    assert found["vertices"] == {
        "0": [0, 0], "1": [2, 0], "2": [2, 2], "3": [0, 2], "e": [4, 0], "f": [4, 2],
    }  # fmt: skip
    assert found["blocks"] == [
        {"corners": ["0", "1", "2", "3"], "cells": [10, 20], "grading": [2, GROW]},
        {"name": "fluid", "corners": ["1", "e", "f", "2"], "cells": [30, 20], "grading": [1, 1, GROW, 0.25]},
    ]
    assert found["edges"] == [{"from": "2", "to": "f", "on": "circle0", "via": [3, 3]}]
    circle = found["curves"]["circle0"]["circle"]
    assert circle["center"] == pytest.approx([3, 2])
    assert circle["radius"] == pytest.approx(1)
    assert found["sides"] == {
        "inlet": [["0", "3"]],
        "outlet": [["e", "f"]],
        "walls": [["0", "1"], ["1", "e"], ["3", "2"], ["2", "f"]],
    }
    assert "joins" not in found


def test_a_layer_across_y_gives_the_same_blocks_turned() -> None:
    rows = TEXT.splitlines()
    turned = [re.sub(r"\((\S+) (\S+) (\S+)\)", r"(\1 \3 \2)", row) if k in (4, 5, 6, 16, 17) else row
              for k, row in enumerate(rows)]  # fmt: skip
    found = read_block_mesh_dict("\n".join(turned))
    assert found["vertices"] == read_block_mesh_dict(TEXT)["vertices"]
    assert found["blocks"] == read_block_mesh_dict(TEXT)["blocks"]


def test_a_block_whose_corners_go_clockwise_is_turned() -> None:
    text = TEXT.replace("hex (0 1 2 3 4 5 6 7) (10 20 1)", "hex (4 5 6 7 0 1 2 3) (10 20 1)")
    assert read_block_mesh_dict(text)["blocks"] == read_block_mesh_dict(TEXT)["blocks"]
    mirrored = TEXT.replace("hex (0 1 2 3 4 5 6 7) (10 20 1) simpleGrading (2 $grow 1)",
                            "hex (0 3 2 1 4 7 6 5) (20 10 1) simpleGrading ($grow 2 1)")  # fmt: skip
    assert read_block_mesh_dict(mirrored)["blocks"] == read_block_mesh_dict(TEXT)["blocks"]


def test_cyclic_patches_become_joins() -> None:
    text = TEXT.replace("inlet { type patch;", "inlet { type cyclic; neighbourPatch outlet;")
    text = text.replace("outlet { type patch;", "outlet { type cyclic; neighbourPatch inlet;")
    found = read_block_mesh_dict(text)
    assert found["joins"] == [{"from": ["0", "3"], "to": ["e", "f"]}]
    assert list(found["sides"]) == ["walls"]


def test_splines_chains_and_origins() -> None:
    for edge, curve in (
        ("spline 2 f ((1.5 1.5 0))", {"points": [[2, 2], [3, 3], [4, 2]]}),
        ("polyLine 2 f ((1.5 1.5 0))", {"polyline": [[2, 2], [3, 3], [4, 2]]}),
        ("arc 2 f origin (1.5 1 0)", {"circle": {"center": [3, 2], "radius": 1}}),
    ):
        found = read_block_mesh_dict(TEXT.replace("arc 2 f (1.5 1.5 0)", edge))
        assert list(found["curves"].values()) == [curve]


REFUSED = {
    "line 13: 'x' is no integer": TEXT.replace("(30 20 1)", "(30 x 1)"),
    "line 12: vertex 99 is none of the 12 vertices": TEXT.replace("hex (0 1", "hex (99 1"),
    "line 17: the edge 'project' is not read": TEXT.replace("arc 2 f (1.5 1.5 0)", "project 2 f (sphere)"),
    "line 17: the three points of the arc lie on a straight line": TEXT.replace("(1.5 1.5 0)", "(1.5 1 0)"),
    "line 28: mergePatchPairs is not read": TEXT.replace("mergePatchPairs ( )", "mergePatchPairs ((a b))"),
    "line 12: the blocks are no layer": TEXT.replace("(0 0 .1)", "(0 0 .2)"),
    "line 12: a block is: hex (8 vertices)": TEXT.replace("simpleGrading (2", "gradedMesh (2"),
    "needs a list vertices": TEXT.replace("vertices\n(", "knots\n("),
    "line 12: '0.1' where a block 'hex' is expected": TEXT.replace("hex (0 1", "0.1 (0 1"),
}


@pytest.mark.parametrize("told", REFUSED)
def test_what_is_not_read_is_refused_by_its_line(told: str) -> None:
    with pytest.raises(InputError) as caught:
        read_block_mesh_dict(REFUSED[told])
    assert told in caught.value.message


# A layer of hexahedra: the plane that it lies in, and the entry of each of its blocks.


CUBE = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0], [0, 0, 1], [2, 0, 1], [2, 1, 1], [0, 1, 1]], dtype=float)
NAMES = [*"abcdefgh"]


@pytest.mark.parametrize(("axis", "cells"), [(0, (1, 5, 6)), (1, (5, 1, 6)), (2, (5, 6, 1))])
def test_the_layer_is_where_a_block_has_one_cell(axis: int, cells: tuple[int, int, int]) -> None:
    block = Hex(tuple(range(8)), cells, tuple(range(2, 14)), "", 3)
    layer = layer_of(CUBE, NAMES, 1.0, [block])
    assert layer.axis == axis
    assert layer.lower.sum() == 4
    entry = block_entry(layer, block)
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = (layer.plane(NAMES.index(name)) for name in entry["corners"])
    assert (x2 - x0) * (y3 - y1) - (y2 - y0) * (x3 - x1) > 0
    # Cells and gradings go with the edges between the corners, whichever way the block is turned.
    steps = {frozenset(entry["corners"][:2]), frozenset(entry["corners"][2:])}
    along_i = next(k for k in range(3) if frozenset(_ends(k)[0]) in steps or frozenset(_ends(k)[1]) in steps)
    assert entry["cells"][0] == cells[along_i]
    assert {(ratio - 2) // 4 for ratio in entry["grading"][:2]} == {along_i}


def _ends(axis: int) -> tuple[set[str], set[str]]:
    """The names at the ends of two edges along a local axis, in the lower plane of each possible layer."""
    return {0: ({"a", "b"}, {"e", "f"}), 1: ({"a", "d"}, {"e", "h"}), 2: ({"a", "e"}, {"b", "f"})}[axis]


def test_two_cells_across_are_no_layer() -> None:
    with pytest.raises(InputError, match="line 3: the blocks are no layer of one cell"):
        layer_of(CUBE, NAMES, 1.0, [Hex(tuple(range(8)), (5, 6, 2), (1.0,) * 12, "", 3)])


def test_vertices_have_names_or_numbers() -> None:
    numbers = {"0": 0, "b": 1}
    assert vertex_of(Word("b", 1), numbers) == 1
    assert vertex_of(Word("1", 1), numbers) == 1
    with pytest.raises(InputError, match="line 9: vertex 2 is none of the 2 vertices"):
        vertex_of(Word("2", 9), numbers)


# Edges and patches of a blockMeshDict: circles that several arcs share, faces by block, cyclic pairs.


def layer() -> Layer:
    corners = np.array([[1, 0], [2, 0], [0, 2], [0, 1]], dtype=float)
    points = np.concatenate([np.pad(corners, ((0, 0), (0, 1)), constant_values=z) for z in (0.0, 1.0)])
    return layer_of(points, [*"01234567"], 1.0, [Hex(tuple(range(8)), (4, 8, 1), (1.0,) * 12, "", 1)])


def entries(text: str) -> tuple[list[dict[str, object]], dict[str, object]]:
    curves: dict[str, object] = {}
    items = parse(f"edges ( {text} );").values["edges"][0]
    return edge_entries(layer(), items.items, curves), curves  # type: ignore[union-attr]


def test_arcs_of_one_circle_share_its_curve() -> None:
    half = 0.5**0.5
    found, curves = entries(f"arc 0 3 ({half} {half} 0) arc 1 2 origin (0 0 0) arc 3 0 ({half} {half} 0) line 0 1")
    assert [entry["on"] for entry in found] == ["circle0", "circle1", "circle0"]
    assert curves["circle0"]["circle"]["radius"] == pytest.approx(1)  # type: ignore[index]
    assert curves["circle1"]["circle"] == {"center": [0, 0], "radius": 2}  # type: ignore[index]


def test_an_edge_without_its_points_is_named() -> None:
    with pytest.raises(InputError, match="line 1: an arc is: arc <vertex> <vertex>"):
        entries("arc 0 3 (1 2)")
    with pytest.raises(InputError, match="line 1: a list in"):
        entries("spline 0 3 4")


def test_faces_by_block_and_by_vertices_are_sides_but_in_the_planes() -> None:
    text = "boundary ( in { faces ((0 4) (0 2)); } out { faces ((1 2 6 5)); } rest { faces ((0 1 2 3)); } );"
    sides, joins = sides_and_joins(layer(), parse(text))
    assert sides == {"in": [["0", "1"]], "out": [["1", "2"]]}
    assert joins == []
    with pytest.raises(InputError, match="a face is 4 vertices, or a block and a face of it"):
        sides_and_joins(layer(), parse("boundary ( in { faces ((0 6)); } );"))


def test_patches_of_old_dictionaries() -> None:
    sides, _ = sides_and_joins(layer(), parse("patches ( wall low ((0 1 5 4)) empty planes ((0 1 2 3)) );"))
    assert sides == {"low": [["0", "1"]]}


def test_cyclic_patches_of_many_edges_are_read_soon() -> None:
    one, other = ("( " + face * 3000 + ")" for face in ("(0 4 7 3)", "(1 2 6 5)"))
    text = f"boundary ( a {{ neighbourPatch b; faces {one}; }} b {{ neighbourPatch a; faces {other}; }} );"
    dictionary, began = parse(text), time.process_time()
    sides, joins = sides_and_joins(layer(), dictionary)
    assert time.process_time() - began < 8.0
    assert (sides, len(joins)) == ({}, 3000)
    assert joins[0] == {"from": ["0", "3"], "to": ["1", "2"]}


def test_more_circles_than_a_mesh_has_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(block_mesh_dict, "MAX_CIRCLES", 1000)
    arcs = " ".join(f"arc 0 3 (0.5 {0.6 + 1e-4 * k} 0)" for k in range(1001))
    began = time.process_time()
    with pytest.raises(InputError, match="line 1: the arcs have more than 1000 circles"):
        entries(arcs)
    assert time.process_time() - began < 8.0
