"""Counts and gradings through opposite edges, and their contradictions by the name of the edge."""

from __future__ import annotations

import pytest

import equimesh as em
from equimesh.blocks.counts import Plan, plan_of
from equimesh.blocks.description import Description
from solver.blocks import documents


def plan(document: dict) -> Plan:
    return plan_of(Description.of(document))


def test_counts_and_gradings_spread_through_opposite_edges() -> None:
    found = plan(documents.l_shape())
    assert found.layout.shapes == ((5, 6), (4, 6), (5, 7))
    graded = {found.layout.edge_name(k) for k, grading in enumerate(found.gradings) if grading[0][2] != 1}
    assert graded == {"a-b", "d-e", "g-h"}
    assert plan(documents.l_shape(refine=2)).layout.shapes == ((9, 11), (7, 11), (9, 13))
    assert plan(documents.l_shape(refine=0.01)).layout.shapes == ((2, 2),) * 3


def test_edges_give_counts_and_gradings_and_joins_carry_them() -> None:
    document = documents.channel(edges=[{"from": "d", "to": "a", "cells": 7, "grading": 5}])
    document["blocks"] = [{"corners": b["corners"], "cells": [6, None]} for b in document["blocks"]]
    found = plan(document)
    assert found.layout.shapes == ((7, 8), (7, 8))
    edge = found.find(("c", "f"), "domain")
    assert found.layout.edge_name(edge) == "c-f"
    assert found.gradings[edge][0][2] == pytest.approx(1 / 5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["blocks"][1].update(cells=[3, 9]), r"the edge b-e has 5 cells by blocks\[0\].cells, but 9 by"),
        (
            lambda d: d["blocks"][0].pop("cells"),
            "no block gives the cells along the edge a-d, .*: give a number in place of null",
        ),
        (lambda d: d["blocks"][2].update(grading=[3, None]), "the edge d-e has two gradings"),
        (
            lambda d: d["blocks"][1].update(corners=["b", "e", "f", "c"]),
            "lie on the same side .* b-e",
        ),
        (lambda d: d["vertices"].update(z=[9, 9]), "vertex z is no corner of a block"),
        (lambda d: d.update(edges=[{"from": "a", "to": "e"}]), "a-e is no edge of a block"),
        (lambda d: d.update(edges=[{"from": "a", "to": "b"}, {"from": "b", "to": "a"}]), "b-a stands twice"),
        (lambda d: d.update(joins=[{"from": ["a", "b"], "to": ["b", "e"]}]), "edge b-e is inside, or joined already"),
        (lambda d: d.update(joins=[{"from": ["a", "d"], "to": ["c", "b"]}]), "c-b is inside|no copies of each other"),
        (lambda d: d.update(joins=[{"from": ["a", "z"], "to": ["c", "f"]}]), "is no vertex"),
        (lambda d: d.update(refine=10_000), "nodes: 50000000 are possible"),
        (lambda d: d["blocks"].append(d["blocks"][0]), "is a side of 3 blocks|same side"),
    ],
)
def test_contradictions_are_refused_by_the_name_of_the_edge(change: object, message: str) -> None:
    document = documents.l_shape()
    change(document)
    with pytest.raises(em.InputError, match=message):
        plan(document)


def test_counts_of_opposite_edges_that_differ_name_both_entries() -> None:
    document = documents.l_shape()
    document["edges"] = [{"from": "c", "to": "f", "cells": 8}]
    with pytest.raises(em.InputError, match=r"edges .*c-f.* have \d cells by .*, but \d by") as caught:
        plan(document)
    assert caught.value.field.endswith(".cells")


def test_joined_edges_must_be_copies() -> None:
    document = documents.channel()
    document["vertices"]["f"] = [3, 1.2]
    with pytest.raises(
        em.InputError, match=r"a-d and c-f are no copies .* c lies \(3, 0\) from a, .* \(3, 0.2\) from d"
    ):
        plan(document)
