"""blockMeshDict: the description of a step with an arc, and what is refused, by its line."""

from __future__ import annotations

import re

import pytest

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_dict import read_block_mesh_dict

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
