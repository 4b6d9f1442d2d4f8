"""Half-edges: which cells meet, and what is said of meshes whose cells do not meet well."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from equimesh.blocks.curves import Circle
from equimesh.blocks.curves import Line as StraightLine
from equimesh.blocks.layout import line_of
from equimesh.blocks.recovery.boundary import Boundary, Corner, Line, with_places
from equimesh.blocks.recovery.half_edges import HalfEdges, blocks_of, counter_clockwise
from equimesh.blocks.recovery.recovered import layout_of
from equimesh.blocks.recovery.shapes import curve_through
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import quads_of_block
from equimesh.numerics.types import Array, IntArray
from solver.blocks.recovery.meshes import Arrays, boundary_of, disc, grid, ring, without


def test_twins_degrees_and_irregular_nodes() -> None:
    points, cells = disc(3)
    edges = HalfEdges.of(points, cells)
    inner = np.flatnonzero(edges.twin >= 0)
    np.testing.assert_array_equal(edges.twin[edges.twin[inner]], inner)
    start, end = cells.ravel(), np.roll(cells, -1, axis=1).ravel()
    np.testing.assert_array_equal(start[edges.twin[inner]], end[inner])
    assert edges.degree[edges.irregular].tolist() == [3, 3, 3, 3]
    np.testing.assert_allclose(np.abs(points[edges.irregular]), 0.5)
    assert edges.boundary.sum() == 12
    np.testing.assert_array_equal(np.sort(np.unique(boundary_of((points, cells)))), np.flatnonzero(edges.boundary))


def test_closed_lines_have_the_domain_on_their_left() -> None:
    points, cells = ring(8, 3)
    loops = HalfEdges.of(points, cells).loops()
    assert [len(loop) for loop in loops] == [8, 8]
    areas = []
    for loop in loops:
        x, y = points[loop].T
        areas.append(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert sorted(np.sign(areas)) == [-1, 1]


def test_clockwise_cells_are_turned_and_keep_their_first_node() -> None:
    points, cells = grid(2, 2)
    mixed = cells.copy()
    mixed[1] = mixed[1, [0, 3, 2, 1]]
    np.testing.assert_array_equal(counter_clockwise(points, mixed), cells)
    assert counter_clockwise(points, cells) is cells


def refused(points: np.ndarray, cells: np.ndarray) -> str:
    with pytest.raises(InputError) as caught:
        HalfEdges.of(points, cells)
    return caught.value.message


def test_a_folded_cell_is_named_with_its_place() -> None:
    points, cells = grid(3, 3)
    points = points.copy()
    points[5] = [0.7, 0.7]
    assert "is folded or flat at node" in refused(points, cells)
    flat = grid(1, 1)[0].copy()
    flat[3] = [0.5, 0.5]
    assert (
        "cell 0, with the nodes [0, 2, 3, 1] near (0.375, 0.375), is folded or flat at node 3 at (0.5, 0.5)"
        in refused(flat, grid(1, 1)[1])
    )


def test_cells_on_the_same_side_of_an_edge_are_named() -> None:
    points, cells = grid(2, 1)
    more = np.concatenate([points, [[0.2, 0.9], [0.2, 0.1]]])
    message = refused(more, np.concatenate([cells[:1], [[2, 3, 6, 7]]]))
    assert message.startswith("the cells 0 and 1 lie on the same side of the edge between the nodes 2 and 3")


def test_an_edge_of_three_cells_is_named() -> None:
    points, cells = grid(2, 1)
    more = np.concatenate([points, [[0.4, 0.0], [0.4, 1.0]]])
    message = refused(more, np.concatenate([cells, [[6, 2, 3, 7]]]))
    assert "the edge between the nodes 2 and 3 near (0.5, 0.5) belongs to more than two cells" in message


def test_a_domain_that_touches_itself_and_one_of_two_pieces() -> None:
    points, cells = grid(2, 2)
    assert "the domain touches itself at node 4 at (0.5, 0.5)" in refused(points[:], cells[[0, 3]])
    points, cells = without(grid(5, 1), (0.4, 0.6, 0, 1))
    message = refused(points, cells)
    assert (
        "several pieces: cell 2, with the nodes [6, 8, 9, 7] near (0.7, 0.5), is not connected with cell 0" in message
    )


# The layout of blocks that are arrays of nodes.


MESHES = {
    "grid": (grid(3, 2), 4, 4),
    "cell": (grid(1, 1), 4, 4),
    "L": (without(grid(4, 4), (0.5, 1, 0.5, 1)), 8, 10),
    "disc": (disc(2), 8, 12),
    "ring": (ring(7, 2), 2, 3),
    "ring of three cells": (ring(3, 1), 2, 3),
}


@pytest.mark.parametrize("name", MESHES)
def test_edges_and_vertices_are_counted_once_and_lines_follow_them(name: str) -> None:
    mesh, vertices, edges = MESHES[name]
    layout, nodes, blocks = found(mesh)
    assert (layout.vertex_count, len(layout.edges)) == (vertices, edges)
    lines = layout.edge_nodes(tuple(blocks))
    for b, block in enumerate(blocks):
        for side in range(4):
            edge, line = layout.block_edges[b, side], line_of(block, side)
            np.testing.assert_array_equal(lines[edge], line[:: 1 if layout.forward[b, side] else -1])
            np.testing.assert_array_equal(nodes[layout.edges[edge]], lines[edge][[0, -1]])
    assert layout.node_count == len(mesh[0])
    assert layout.shapes == tuple(block.shape for block in blocks)


def found(mesh: Arrays):
    points, cells = mesh
    edges = HalfEdges.of(points, cells)
    corners = np.zeros(len(points), np.bool_)
    blocks, _ = blocks_of(edges, corners)
    return *layout_of(blocks), blocks


def test_an_interface_is_one_edge_of_two_blocks() -> None:
    layout, _, _ = found(MESHES["disc"][0])
    assert sorted(layout.edge_uses.tolist()) == [1] * 4 + [2] * 8
    assert len(layout.boundary) == 4
    assert len(layout.counts) == 3


# Blocks by lines from irregular nodes: which there are, and that each node and cell is where it belongs.


def blocks(mesh: Arrays, vertices: tuple[int, ...] = ()) -> list[IntArray]:
    points, cells = mesh
    fixed = np.zeros(len(points), np.bool_)
    fixed[list(vertices)] = True
    found, own = blocks_of(HalfEdges.of(points, cells), fixed)
    taken = np.concatenate([part.ravel() for part in own])
    np.testing.assert_array_equal(np.sort(taken), np.arange(len(cells)))
    for block, part in zip(found, own, strict=True):
        assert part.shape == (block.shape[0] - 1, block.shape[1] - 1)
        np.testing.assert_array_equal(np.sort(quads_of_block(block), axis=1), np.sort(cells[part.ravel()], axis=1))
    return found


def test_a_grid_is_one_block_in_its_own_directions() -> None:
    (block,) = blocks(grid(5, 3))
    np.testing.assert_array_equal(block, np.arange(24).reshape(6, 4))


def test_blocks_do_not_depend_on_where_cells_begin_but_for_their_directions() -> None:
    points, cells = grid(5, 3)
    random = np.random.default_rng(2)
    turned = np.array([np.roll(cell, random.integers(4)) for cell in cells])[random.permutation(15)]
    (block,) = blocks((points, turned))
    assert sorted(block.shape) == [4, 6]
    assert sorted([block[0, 0], block[0, -1], block[-1, 0], block[-1, -1]]) == [0, 3, 20, 23]


@pytest.mark.parametrize(
    ("mesh", "count"),
    [
        (without(grid(4, 4), (0.5, 1, 0.5, 1)), 3),  # an L
        (without(grid(6, 6), (0.3, 0.7, 0.3, 0.7)), 8),  # a hole
        (disc(3), 5),
    ],
)
def test_lines_from_irregular_nodes_cut_the_mesh(mesh: Arrays, count: int) -> None:
    assert len(blocks(mesh)) == count


def test_a_corner_of_two_cells_cuts_where_it_is_named() -> None:
    assert len(blocks(grid(6, 4))) == 1
    assert [block.shape for block in blocks(grid(6, 4), (10,))] == [(3, 5), (5, 5)]


def test_a_ring_is_one_block_that_closes_at_its_first_cell() -> None:
    (block,) = blocks(ring(9, 2))
    assert block.shape in {(3, 10), (10, 3)}
    around = block if block.shape == (10, 3) else block.T
    np.testing.assert_array_equal(around[0], around[-1])
    assert sorted(around[0].tolist()) == [0, 1, 2]


def test_a_ring_in_a_ring_is_cut_once() -> None:
    """A node of two cells of the inner side that is a corner makes a line, which is the cut of both."""
    (block,) = blocks(ring(9, 4), (20,))
    around = block if block.shape == (10, 5) else block.T
    assert 20 in around[0]
    np.testing.assert_array_equal(around[0], around[-1])


def test_every_edge_of_a_block_is_whole_one_of_its_neighbour() -> None:
    found = blocks(without(grid(9, 7), (0.4, 0.6, 0.2, 0.6)))
    lines = [line for block in found for line in (block[0], block[-1], block[:, 0], block[:, -1])]
    keys = [min(tuple(line.tolist()), tuple(line[::-1].tolist())) for line in lines]
    steps: dict[tuple[int, int], set[tuple[int, ...]]] = {}
    for key in keys:
        for a, b in itertools.pairwise(key):
            steps.setdefault((min(a, b), max(a, b)), set()).add(key)
    assert all(len(users) == 1 for users in steps.values())


def of(mesh: Arrays, sides: dict[str, IntArray] | None = None, **settings: object) -> Boundary:
    points, cells = mesh
    return Boundary.of(points, HalfEdges.of(points, cells), sides or {}, **settings)  # type: ignore[arg-type]


def test_sides_without_a_name_go_from_corner_to_corner() -> None:
    found = of(grid(3, 2))
    assert [len(edges) for edges in found.sides.values()] == [3, 2, 3, 2]
    assert list(found.sides) == ["side_1", "side_2", "side_3", "side_4"]
    assert found.corners.tolist() == [0, 2, 9, 11]
    for edges in found.sides.values():
        np.testing.assert_array_equal(edges[1:, 0], edges[:-1, 1])


def test_named_sides_in_order_stay_as_they_are_and_others_are_ordered_and_turned() -> None:
    mesh = grid(4, 3)
    ordered = {name: edges for name, edges in of(mesh).sides.items() if name != "side_3"}
    named = {"low": ordered["side_1"], "walls": np.concatenate([ordered["side_4"], ordered["side_2"]])}
    found = of(mesh, named).sides
    assert list(found) == ["low", "walls", "side_1"]
    for name, edges in named.items():
        np.testing.assert_array_equal(found[name], edges)
    random = np.random.default_rng(4)
    mixed = {name: random.permutation(edges)[:, ::-1] for name, edges in named.items()}
    for name, edges in of(mesh, mixed).sides.items():
        assert {tuple(edge) for edge in edges.tolist()} == {tuple(edge) for edge in found[name].tolist()}
    np.testing.assert_array_equal(of(mesh, mixed).sides["low"], found["low"])


def test_a_closed_side_begins_with_its_first_edge() -> None:
    mesh = ring(14, 2)
    outer = [edge for edge in boundary_of(mesh).tolist() if edge[0] % 3 == 2]
    turned = np.array(outer[5:] + outer[:5])
    found = of(mesh, {"far": turned})
    assert found.sides["far"].tolist() == turned.tolist()
    assert [line.is_closed for line in found.lines] == [True, True]
    assert len(found.corners) == 0


def test_ends_of_sides_stay() -> None:
    mesh = grid(6, 1)
    low = of(mesh).sides["side_1"]
    found = of(mesh, {"inlet": low[:2], "wall": low[2:]})
    assert 4 in found.corners
    assert [len(line.nodes) for line in found.lines] == [3, 5, 2, 7, 2]


@pytest.mark.parametrize(("height", "corner"), [(0.0, False), (0.03, True), (0.5, True)])
def test_a_small_turn_is_a_corner_where_it_stands_alone(height: float, corner: bool) -> None:
    points, cells = grid(8, 2)
    points = points.copy()
    points[:, 1] += height * np.maximum(0.0, points[:, 0] - 0.5) * (1 - points[:, 1])
    assert (12 in of((points, cells)).corners) == corner
    assert 12 not in of((points, cells), corner_angle=40.0).corners
    assert 12 in of((points, cells), corner_angle=40.0, corners=[12]).corners
    assert 12 in of((points, cells), corner_angle=180.0, corners=[(0.51, -0.2)]).corners


@pytest.mark.parametrize(
    ("before", "after", "corner"),
    [(1.19, 1.19, True), (1.21, 0.0, False), (0.0, 1.21, False), (-1.21, 0.0, False), (0.0, 0.0, True)],
)
def test_a_small_turn_is_a_corner_by_its_ratio_to_those_beside_it(before: float, after: float, corner: bool) -> None:
    points, cells = grid(8, 2)
    ways = np.radians(np.cumsum([0, 0, 0, before, 6.0, after, 0, 0]))  # of the edges of the lower side; 5 times 1.2
    low = np.concatenate([[[0.0, 0.0]], np.cumsum(np.column_stack([np.cos(ways), np.sin(ways)]), axis=0)]) / 8
    bent = np.concatenate([low[:, None] + np.array([[0.0, 0.0], [0.0, 0.5], [0.0, 1.0]])]).reshape(-1, 2)
    assert points.shape == bent.shape
    assert (12 in of((bent, cells)).corners) == corner


def test_a_coarse_circle_has_no_corners() -> None:
    assert len(of(ring(13, 1)).corners) == 0
    assert len(of(ring(13, 1), corner_angle=10.0).corners) == 26


@pytest.mark.parametrize(
    ("sides", "told"),
    [
        (
            {"mid": [[4, 7]]},
            "'mid' has the edge between the nodes 4 and 7 near (0.5, 0.5), which is not on the boundary",
        ),
        (
            {"a": [[0, 3]], "b": [[3, 0]]},
            "the edge between the nodes 3 and 0 near (0.166667, 0) belongs to the sides 'a' and 'b'",
        ),
        ({"a": np.empty((0, 2), int)}, "the side 'a' has no edges"),
    ],
)
def test_wrong_sides_are_named(sides: dict[str, object], told: str) -> None:
    with pytest.raises(InputError) as caught:
        of(grid(3, 2), {name: np.array(edges) for name, edges in sides.items()})
    assert told in caught.value.message


@pytest.mark.parametrize("corner", [4, 99, -1, (1.0, 2.0, 3.0), (float("nan"), 0.0), True])
def test_wrong_corners_are_named(corner: Corner) -> None:
    with pytest.raises(InputError, match=r"corners\[1\]"):
        of(grid(2, 2), corners=[0, corner])


def test_corners_by_the_names_of_points() -> None:
    assert with_places(["te", 3, (1.0, 2.0)], {"te": 7}) == [7, 3, (1.0, 2.0)]
    with pytest.raises(InputError, match=r"corners\[1\] = 'le' is no named point of the file: there are te"):
        with_places(["te", "le"], {"te": 7})


def test_nodes_at_the_same_place_are_named() -> None:
    points, cells = without(grid(4, 4), (0.25, 0.75, 0.25, 0.75))
    hole = np.flatnonzero((np.abs(points - 0.5) < 0.3).all(axis=1))
    shut = points.copy()
    shut[hole, 1] = 0.5 + 1e-13 * (points[hole, 1] - 0.5)
    with pytest.raises(InputError) as caught:
        of((shut, cells))
    assert "lie at the same place (" in caught.value.message
    assert "Remove duplicate nodes" in caught.value.message


def test_a_node_in_the_middle_of_an_edge_is_named() -> None:
    points, cells = grid(2, 2)
    inner = np.array([[0.5, 0.25], [1.0, 0.25]])  # the lower right cell is cut, its neighbour is not
    cut = np.array([cells[0], cells[1], cells[3], [3, 6, 10, 9], [9, 10, 7, 4]])
    with pytest.raises(InputError, match=r"in the middle of (its|the) edge"):
        of((np.concatenate([points, inner]), cut))


def test_a_corner_that_is_a_word_is_refused_with_its_entry() -> None:
    with pytest.raises(InputError, match=r"corners\[1\] = 'tip': give the number of a node, or its place"):
        of(grid(3, 2), corners=[0, "tip"])


S = np.array([0.0, 0.1, 0.3, 0.35, 0.6, 0.8, 1.0])
SHAPES = {
    "straight": (np.column_stack([1 - 2 * S, 0.5 + S]), False, StraightLine),
    "arc": (np.column_stack([3 + 2 * np.cos(1 - 2 * S), np.sin(1 - 2 * S) * 2]), False, Circle),
    "large arc": (np.column_stack([np.cos(5 * S + 2), np.sin(5 * S + 2)]), False, Circle),
    "circle": (np.column_stack([np.cos(6 * S), 1 + np.sin(6 * S)]), True, Circle),
    "clockwise": (np.column_stack([np.cos(-6 * S), 1 + np.sin(-6 * S)]), True, Circle),
    "ellipse": (np.column_stack([2 * np.cos(6 * S), np.sin(6 * S)]), True, SplineCurve),
    "parabola": (np.column_stack([S, S**2]), False, SplineCurve),
    "three nodes": (np.column_stack([S, S**2])[:3], False, SplineCurve),
    "nearly straight": (np.column_stack([S, 1e-7 * np.sin(3 * S)]), False, SplineCurve),
    "a straight line turned": (np.column_stack([S, np.pi * S]) @ [[0.6, 0.8], [-0.8, 0.6]], False, StraightLine),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_curve_goes_through_the_nodes_at_their_parameters(name: str) -> None:
    points, closed, kind = SHAPES[name]
    curve, t = curve_through(points, Line(nodes=np.arange(len(points)), is_closed=closed), 1.0)
    assert isinstance(curve, kind)
    assert len(t) == len(points) + closed
    assert (np.diff(t) > 0).all() or (np.diff(t) < 0).all()
    wanted = np.concatenate([points, points[:1]]) if closed else points
    found: Array = np.column_stack(curve.evaluate(t)[:2])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
    if closed:
        low, high = curve.ends
        assert abs(t[-1] - t[0]) == pytest.approx(high - low)
