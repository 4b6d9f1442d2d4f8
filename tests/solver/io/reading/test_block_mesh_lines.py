"""Edges and patches of a blockMeshDict: circles that several arcs share, faces by block, cyclic pairs."""

from __future__ import annotations

import time

import numpy as np
import pytest

from equimesh.errors import InputError
from equimesh.io.reading.block_mesh_dict import Hex, Layer, edge_entries, layer_of, sides_and_joins
from equimesh.io.reading.foam import parse


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
    one, other = ("( " + face * 10_000 + ")" for face in ("(0 4 7 3)", "(1 2 6 5)"))
    text = f"boundary ( a {{ neighbourPatch b; faces {one}; }} b {{ neighbourPatch a; faces {other}; }} );"
    dictionary, began = parse(text), time.process_time()
    sides, joins = sides_and_joins(layer(), dictionary)
    assert time.process_time() - began < 8.0
    assert (sides, len(joins)) == ({}, 10_000)
    assert joins[0] == {"from": ["0", "3"], "to": ["1", "2"]}


def test_more_circles_than_a_mesh_has_are_refused() -> None:
    arcs = " ".join(f"arc 0 3 (0.5 {0.6 + 1e-5 * k} 0)" for k in range(10_001))
    began = time.process_time()
    with pytest.raises(InputError, match="line 1: the arcs have more than 10000 circles"):
        entries(arcs)
    assert time.process_time() - began < 8.0
