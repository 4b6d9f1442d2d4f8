"""Initial meshes: vertices on their curves, graded edges, copies, and which nodes slide."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.blocks import Blocks
from equimesh.blocks.curves import Circle, Line
from equimesh.blocks.initial import transfinite
from equimesh.blocks.sliding import FIXED, FREE
from solver.blocks import documents


def test_vertices_that_are_nearly_on_their_curve_are_moved_there() -> None:
    document = documents.ring(vertices={"i": [1.01, 0.01], "o": [1.99, 0]})
    mesh = Blocks.of(document).mesh
    for name, radius in (("hole", 1.0), ("boundary", 2.0)):
        edges = mesh.sides[name]
        assert np.hypot(*mesh.points[edges[:, 0]].T) == pytest.approx(radius, abs=1e-14)


def test_a_vertex_away_from_the_curve_is_refused_with_the_nearest_point() -> None:
    document = documents.ring(vertices={"i": [1.2, 0], "o": [2, 0]})
    with pytest.raises(em.InputError, match=r"edge i-i .* inner, .* \(1.2, 0\) is 0.2 away .* \(1, 0\)") as caught:
        Blocks.of(document)
    assert caught.value.field == "domain.edges[0].on"


def test_a_vertex_of_two_curves_stands_where_they_meet() -> None:
    document = {
        "vertices": {"a": [0, 0], "b": [1, 0.02], "c": [1, 1], "d": [0, 1]},
        "curves": {
            "low": {"x": "t", "y": "0.3*t*(1 - t)"},
            "right": {"circle": {"center": [1.5, 0.5], "radius": 0.5**0.5}},
        },
        "edges": [{"from": "a", "to": "b", "on": "low"}, {"from": "b", "to": "c", "on": "right"}],
        "blocks": [{"corners": ["a", "b", "c", "d"], "cells": [4, 4]}],
    }
    found = Blocks.of(document)
    x, y = found.mesh.points[found.mesh.blocks[0][-1, 0]]
    assert y == pytest.approx(0.3 * x * (1 - x), abs=1e-8)
    assert math.hypot(x - 1.5, y - 0.5) == pytest.approx(math.sqrt(0.5), abs=1e-8)
    document["curves"]["right"] = {"points": [[1.01, 0.0], [1.01, 1.0]]}
    with pytest.raises(em.InputError, match="which do not meet"):
        Blocks.of(document)


def test_an_edge_through_a_corner_of_its_curve_is_refused() -> None:
    square = {"points": [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]}
    document = {
        "vertices": {"a": [0, 0], "b": [1, 1], "c": [3, 1], "d": [3, 0]},
        "curves": {"wall": square},
        "edges": [{"from": "a", "to": "b", "on": "wall", "via": [1, 0]}],
        "blocks": [{"corners": ["a", "d", "c", "b"], "cells": [4, 4]}],
    }
    with pytest.raises(em.InputError, match=r"edge a-b runs through the corner \(1, 0\) of the curve wall"):
        Blocks.of(document)


def test_a_loop_needs_a_curve() -> None:
    with pytest.raises(em.InputError, match="the edge i-i begins and ends at one vertex"):
        Blocks.of(documents.ring(edges=[{"from": "o", "to": "o", "on": "outer"}]))


def test_copies_lie_apart_by_the_translation() -> None:
    mesh = Blocks.of(documents.channel()).mesh
    gap = mesh.points[mesh.ties[:, 0]] - mesh.points[mesh.ties[:, 1]]
    assert gap == pytest.approx(np.tile([3.0, 0.0], (5, 1)), abs=1e-15)
    heights = np.diff(mesh.y[mesh.ties[:, 1]])
    assert heights[-1] / heights[0] == pytest.approx(3.0)


# Nodes between four sides.


def test_a_skew_block_with_graded_sides_is_met_exactly() -> None:
    bottom, top = np.array([0.0, 0.2, 0.5, 1.0]), np.array([0.0, 0.4, 0.7, 1.0])
    left = np.array([0.0, 0.3, 1.0])

    def at(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        u, v = np.broadcast_arrays(u, v)
        return np.stack([2 * u + 0.3 * v, v + 0.5 * u], axis=-1)

    sides = at(np.zeros(3), left), at(np.ones(3), left), at(bottom, np.zeros(4)), at(top, np.ones(4))
    found = transfinite(sides, (left, left, bottom, top))
    assert found.shape == (4, 3, 2)
    assert found == pytest.approx(at(bottom[:, None] + left * (top - bottom)[:, None], left[None, :]))


def test_sides_are_kept_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    shares = np.array([0.0, 0.4, 1.0])
    corner = {(i, j): np.array([i, j], dtype=float) for i in (0, 1) for j in (0, 1)}

    def side(a: tuple[int, int], b: tuple[int, int]) -> np.ndarray:
        return np.array([corner[a], 0.5 * (corner[a] + corner[b]) + 0.1 * rng.uniform(size=2), corner[b]])

    sides = side((0, 0), (0, 1)), side((1, 0), (1, 1)), side((0, 0), (1, 0)), side((0, 1), (1, 1))
    found = transfinite(sides, (shares,) * 4)
    for line, wanted in zip((found[0], found[-1], found[:, 0], found[:, -1]), sides, strict=True):
        assert np.array_equal(line, wanted)


def test_sides_are_blended_where_the_lines_between_opposite_shares_cross() -> None:
    bottom, top = np.array([0.0, 0.2, 1.0]), np.array([0.0, 0.6, 1.0])
    left = np.array([0.0, 0.5, 1.0])
    zero, one = np.zeros(3), np.ones(3)
    bulge = np.column_stack([0.1 * np.sin(np.pi * left), left])
    sides = bulge, np.column_stack([one, left]), np.column_stack([bottom, zero]), np.column_stack([top, one])
    found = transfinite(sides, (left, left, bottom, top))
    assert found[1, 1] == pytest.approx([0.4 + (1 - 0.4) * 0.1, 0.5])


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
