"""Descriptions: records, and the path of what cannot be used."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.blocks.description import Description
from solver.blocks import documents


def test_records_have_what_the_document_says() -> None:
    found = Description.of(documents.channel(kind="blocks", corners=["b"], refine=2))
    assert found.blocks[0].corners == ("a", "b", "e", "d")
    assert found.blocks[1].cells == (4, None)
    assert (found.blocks[0].name, found.edges[0].on, found.corners, found.refine) == ("block0", "bump", ("b",), 2.0)
    assert found.joins == ((("a", "d"), ("c", "f")),)
    left, right, bottom, top = found.blocks[0].gradings
    assert (left, bottom) == (((1.0, 1.0, 3.0),), ((1.0, 1.0, 1.0),))
    assert (right, top) == (left, bottom)


def test_four_gradings_are_along_i_and_then_along_j() -> None:
    document = documents.l_shape()
    document["blocks"][0]["grading"] = [2, 3, 4, 5]
    assert [grading[0][2] for grading in Description.of(document).blocks[0].gradings if grading] == [4, 5, 2, 3]


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"kind": "rectangle"}, "domain.kind"),
        ({"vertex": {}}, "domain.vertex"),
        ({"vertices": None}, "domain.vertices"),
        ({"vertices": {"a": [0]}}, "domain.vertices.a"),
        ({"blocks": []}, "domain.blocks"),
        ({"blocks": [{"corners": ["a", "b", "e"]}]}, "domain.blocks[0].corners"),
        ({"blocks": [{"corners": ["a", "b", "e", "z"]}]}, "domain.blocks[0].corners[3]"),
        ({"blocks": [{"corners": ["a", "b", "e", "d"], "cells": [0, 1]}]}, "domain.blocks[0].cells[0]"),
        ({"blocks": [{"corners": ["a", "b", "e", "d"], "cells": 4}]}, "domain.blocks[0].cells"),
        ({"blocks": [{"corners": ["a", "b", "e", "d"], "grading": [1, 2, 3]}]}, "domain.blocks[0].grading"),
        ({"blocks": [{"corners": ["a", "b", "e", "d"], "name": ""}]}, "domain.blocks[0].name"),
        ({"edges": [{"from": "a"}]}, "domain.edges[0].to"),
        ({"edges": [{"from": "a", "to": "b", "on": "wall"}]}, "domain.edges[0].on"),
        ({"edges": [{"from": "a", "to": "b", "via": [1]}]}, "domain.edges[0].via"),
        ({"joins": [{"from": ["a", "b"]}]}, "domain.joins[0].to"),
        ({"sides": {"": []}}, "domain.sides"),
        ({"sides": {"wall": [["a", "z"]]}}, "domain.sides.wall[0][1]"),
        ({"sides": {f"s{k}": [] for k in range(1001)}}, "domain.sides"),
        ({"sides": {"wall": [["a", "b"]] * 1000}}, "domain.sides"),
        ({"corners": ["z"]}, "domain.corners[0]"),
        ({"refine": 0}, "domain.refine"),
    ],
)
def test_bad_entries_are_refused_with_their_path(change: dict, field: str) -> None:
    with pytest.raises(em.InputError) as caught:
        Description.of(documents.l_shape(**change))
    assert caught.value.field == field


def test_an_edge_of_a_side_is_a_list_of_two_vertices() -> None:
    with pytest.raises(em.InputError, match=r"\[0\] is the text 'a': it must be a list of two vertices"):
        Description.of(documents.l_shape(sides={"wall": ["a", "b"]}))


def test_deep_entries_are_refused_by_their_path() -> None:
    deep: list = []
    for _ in range(3000):
        deep = [deep]
    document = documents.l_shape()
    document["blocks"][0]["grading"] = deep
    with pytest.raises(em.InputError) as refused:
        Description.of(document)
    assert refused.value.field == "domain.blocks[0].grading"
