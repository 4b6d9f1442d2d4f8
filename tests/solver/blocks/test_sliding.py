"""Which nodes slide, and on which curve."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Circle, Line
from equimesh.blocks.sliding import FIXED, FREE
from solver.blocks import documents


def node(blocks: Blocks, x: float, y: float) -> int:
    distance = np.hypot(blocks.mesh.x - x, blocks.mesh.y - y)
    assert distance.min() < 1e-12
    return int(distance.argmin())


def test_straight_edges_in_one_direction_are_one_line() -> None:
    found = Blocks.of(documents.l_shape())
    assert {(c.start, c.end) for c in found.curves if isinstance(c, Line)} == {
        ((0.0, 0.0), (2.0, 0.0)),
        ((0.0, 0.0), (0.0, 2.0)),
        ((2.0, 0.0), (2.0, 1.0)),
        ((1.0, 1.0), (2.0, 1.0)),
        ((1.0, 1.0), (1.0, 2.0)),
        ((0.0, 2.0), (1.0, 2.0)),
    }
    kinds = found.node_curve
    assert {tuple(found.mesh.points[k]) for k in np.flatnonzero(kinds == FIXED)} == {
        (0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, 2.0), (0.0, 2.0),
    }  # fmt: skip
    assert kinds[node(found, 1.0, 0.0)] >= 0  # a corner of two blocks slides along the bottom
    assert found.node_parameter[node(found, 1.0, 0.0)] == 1.0
    stays = Blocks.of(documents.l_shape(corners=["b"]))
    assert stays.node_curve[node(stays, 1.0, 0.0)] == FIXED


@pytest.mark.parametrize("document", [documents.l_shape(), documents.ring(), documents.channel()])
def test_parameters_give_the_nodes(document: dict) -> None:
    found = Blocks.of(document)
    on = np.flatnonzero(found.node_curve >= 0)
    for k in on:
        x, y, *_ = found.curves[found.node_curve[k]].evaluate(found.node_parameter[k])
        assert np.hypot(x - found.mesh.x[k], y - found.mesh.y[k]) < 1e-12
    boundary = {int(n) for edge in found.boundary_edges for n in edge.nodes}
    assert boundary >= set(on.tolist())
    free = np.flatnonzero(found.node_curve == FREE)
    assert not boundary & set(free.tolist())


def test_a_vertex_slides_around_a_circle() -> None:
    found = Blocks.of(documents.ring())
    assert not (found.node_curve == FIXED).any()
    assert [type(curve) for curve in found.curves] == [Circle, Circle]


def test_both_copies_of_a_joined_vertex_slide_on_their_line_or_stay() -> None:
    found = Blocks.of(documents.channel())
    assert (found.node_curve[[node(found, 0, 1), node(found, 3, 1)]] >= 0).all()  # the straight top
    assert (found.node_curve[[node(found, 0, 0), node(found, 3, 0)]] == FIXED).all()  # a bump and a straight bottom
    assert (found.node_curve[found.mesh.ties[1:-1]] == FREE).all()
    bent = documents.channel(edges=[], curves={})
    bent["vertices"]["b"] = [2, 0.2]
    roof = Blocks.of(bent)
    assert (roof.node_curve[[node(roof, 0, 0), node(roof, 3, 0)]] == FIXED).all()  # two lines, not one direction
    stays = Blocks.of(documents.channel(corners=["d"]))
    assert (stays.node_curve[[node(stays, 0, 1), node(stays, 3, 1)]] == FIXED).all()


def test_a_vertex_inside_stays_where_it_is_named() -> None:
    document = documents.ring()
    document["vertices"] |= {"m": [1.5, 0]}
    document["blocks"] = [
        {"corners": ["i", "m", "m", "i"], "cells": [2, 24]},
        {"corners": ["m", "o", "o", "m"], "cells": [2, None]},
    ]
    document["curves"]["middle"] = {"circle": {"radius": 1.5}}
    document["edges"].append({"from": "m", "to": "m", "on": "middle"})
    free, stays = Blocks.of(document), Blocks.of(document | {"corners": ["m"]})
    assert (free.node_curve[node(free, 1.5, 0)], stays.node_curve[node(stays, 1.5, 0)]) == (FREE, FIXED)


def test_the_end_of_a_slit_stays() -> None:
    document = {
        "vertices": {
            "a": [-1, -1],
            "b": [0, -1],
            "c": [1, -1],
            "d": [-1, 0],
            "tip": [0, 0],
            "low": [1, 0],
            "high": [1, 0],
            "e": [-1, 1],
            "f": [0, 1],
            "g": [1, 1],
        },
        "blocks": [
            {"corners": ["a", "b", "tip", "d"], "cells": [3, 3]},
            {"corners": ["b", "c", "low", "tip"], "cells": [3, None]},
            {"corners": ["d", "tip", "f", "e"], "cells": [None, 3]},
            {"corners": ["tip", "high", "g", "f"], "cells": [3, None]},
        ],
    }
    found = Blocks.of(document)
    assert found.node_curve[node(found, 0, 0)] == FIXED
    assert len(found.curves) == 7  # the two faces of the slit are two lines
