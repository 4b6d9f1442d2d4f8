"""Meshes of blocks: Jacobians, folds, triangles, edges and neighbours of cells, and the cells of points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from block_cases import changed, channel, in_blocks, l_shape
from equimesh.errors import InputError
from equimesh.meshes.cell_edges import (
    MAX_SPOKES,
    NO_CELL,
    CellEdges,
    corner_at,
    links_of,
    originals_of,
    quads_of_block,
    spokes_of,
)
from equimesh.meshes.interfaces import EDGES, Contact, contacts
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import (
    FAR,
    FEW_STEPS,
    MAX_CALLS,
    MAX_KEPT,
    UNCLEAR,
    QuadSearch,
    box_of,
    nearest_edge,
    search_box,
    walk_cells,
    walk_clear,
)
from solver.meshes.quad_cases import bent, box, corner, disc, inner_points, ring
from solver.quality.handmade import wavy


def two_blocks(points: np.ndarray | None = None) -> Mesh:
    """Two blocks of 2 x 2 and 1 x 2 cells side by side; the second one begins on the right."""
    left = np.arange(9).reshape(3, 3)
    right = np.array([[6, 7, 8], [9, 10, 11]])
    x, y = np.meshgrid([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0], indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel()]) if points is None else points
    cells = np.concatenate([quads_of_block(left), quads_of_block(right)])
    return Mesh(points=places, cells=cells, sides={"inlet": np.array([[2, 1], [1, 0]])}, blocks=(left, right))


def test_shapes_names_and_views() -> None:
    mesh = two_blocks()
    assert (mesh.node_shape, mesh.cell_shape, mesh.block_names) == ((12,), (6,), ("block0", "block1"))
    assert mesh.x[9] == 3.0
    assert mesh.block_mesh(1).x.tolist() == [[2.0] * 3, [3.0] * 3]
    uniform = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    assert (uniform.node_shape, uniform.cell_shape) == ((5, 4), (4, 3))


def test_cells_of_a_block_are_found_in_any_order() -> None:
    mesh = two_blocks()
    assert [cells.tolist() for cells in mesh.block_cells] == [[[0, 1], [2, 3]], [[4, 5]]]
    order = np.array([3, 5, 0, 1, 4, 2])
    turned = np.roll(mesh.cells[order], 1, axis=1)
    shuffled = Mesh(points=mesh.points, cells=turned, sides={}, blocks=mesh.blocks)
    for mine, other in zip(mesh.block_cells, shuffled.block_cells, strict=True):
        assert (order[other] == mine).all()
    short = Mesh(points=mesh.points, cells=mesh.cells[:-1], sides={}, blocks=mesh.blocks)
    with pytest.raises(em.InputError, match=r"\[7, 8, 10, 11\], which is no cell"):
        _ = short.block_cells


def test_jacobians_are_relative_to_the_mean_cell() -> None:
    mesh = two_blocks()
    assert np.allclose(mesh.corner_jacobians(), np.ones((4, 6)))
    assert mesh.cell_areas() == pytest.approx(np.ones(6))
    points = mesh.points.copy()
    points[4] += [0.25, 0.0]
    bent = mesh.moved(points)
    assert bent.min_jacobian == pytest.approx(bent.corner_jacobians().min()) == pytest.approx(0.75)
    assert bent.distance(mesh) == 0.25
    assert bent.block_cells[1].tolist() == [[4, 5]]


@pytest.mark.parametrize("value", [2.0, 2.5, math.nan, math.inf])
def test_a_node_beyond_the_next_one_folds(value: float) -> None:
    mesh = two_blocks()
    assert not mesh.is_folded
    points = mesh.points.copy()
    points[4, 0] = value
    assert mesh.moved(points).is_folded


def test_threads_see_each_cell() -> None:
    x, y = np.meshgrid(np.arange(260.0), np.arange(140.0), indexing="ij")
    block = np.arange(x.size).reshape(x.shape)
    points = np.column_stack([x.ravel(), y.ravel()])
    mesh = Mesh(points=points, cells=quads_of_block(block), sides={}, blocks=(block,))
    assert not mesh.is_folded_on(2)
    for node in (block[1, 1], block[-2, -2]):
        moved = points.copy()
        moved[node] += 2.0
        assert mesh.moved(moved).is_folded_on(2)


def test_triangles_fill_the_cells_and_have_one_edge_on_the_boundary() -> None:
    mesh = two_blocks()
    parts = mesh.mesh_parts("triangle")
    assert parts.shape is None
    corners = parts.points[parts.cells]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.allclose(0.5 * (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]), 0.5)
    edges = np.sort(np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 3, 2)
    keys = edges[..., 0] * 100 + edges[..., 1]
    free = np.array([[np.count_nonzero(keys == key) == 1 for key in row] for row in keys])
    assert free.sum(axis=1).max() == 1
    assert np.array_equal(parts.mesh_parts("quad").cells, mesh.cells)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.zeros((3, 3))}, r"points has shape \(3, 3\)"),
        ({"cells": np.zeros((3, 3), dtype=int)}, r"cells has shape"),
        ({"cells": np.array([[0, 1, 2, 12]])}, r"cells\[0\]\[3\] = 12"),
        ({"sides": {"wall": np.array([[0, -1]])}}, r"sides.wall\[0\]\[1\] = -1"),
        ({"blocks": (np.array([[0, 1, 2]]),)}, r"blocks\[0\] has shape"),
        ({"block_names": ("one",)}, "1 names for 2 blocks"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change: dict, message: str) -> None:
    mesh = two_blocks()
    given = {"points": mesh.points, "cells": mesh.cells, "sides": {}, "blocks": mesh.blocks} | change
    with pytest.raises(em.InputError, match=message):
        Mesh(**given)


def edges_of(mesh: Mesh) -> CellEdges:
    return CellEdges.of(mesh.cells, len(mesh.points), mesh.ties)


def test_every_edge_is_found_once_with_the_cells_on_both_sides() -> None:
    mesh = in_blocks(wavy()).mesh
    found = edges_of(mesh)
    assert len(found.cells) == 12 * 9 + 13 * 8
    for k, (cells, places) in enumerate(zip(found.cells, found.places, strict=True)):
        pairs = {
            frozenset((mesh.cells[cell, place], mesh.cells[cell, (place + 1) % 4]))
            for cell, place in zip(cells.tolist(), places.tolist(), strict=True)
            if cell != NO_CELL
        }
        assert len(pairs) == 1
        for cell, place in zip(cells.tolist(), places.tolist(), strict=True):
            assert cell == NO_CELL or found.of_cells[cell, place] == k
    assert found.is_outer.sum() == 2 * 12 + 2 * 8


def test_the_outer_edges_are_those_of_the_sides_and_neighbours_see_each_other() -> None:
    mesh = l_shape()
    found = edges_of(mesh)
    outer = np.flatnonzero(found.is_outer)
    first, place = found.cells[outer, 0], found.places[outer, 0]
    ends = np.column_stack([mesh.cells[first, place], mesh.cells[first, (place + 1) % 4]])
    assert {*map(tuple, ends.tolist())} == {*map(tuple, np.concatenate([*mesh.sides.values()]).tolist())}
    around = found.neighbours
    for cell, others in enumerate(around.tolist()):
        assert all(other == NO_CELL or cell in around[other] for other in others)
    assert (around == NO_CELL).sum() == len(outer)


def test_joined_sides_are_inner_edges() -> None:
    mesh = channel(5)
    assert edges_of(mesh).is_outer.sum() == 2 * 9
    assert originals_of(4, np.array([[3, 2], [2, 0]])) == pytest.approx([0, 1, 0, 0])
    assert originals_of(4, None).tolist() == originals_of(4, np.empty((0, 2), dtype=np.int64)).tolist() == [0, 1, 2, 3]


def test_an_edge_with_three_cells_is_refused() -> None:
    cells = np.array([[0, 1, 2, 3], [1, 0, 4, 5], [0, 1, 6, 7]])
    with pytest.raises(InputError, match="the edge from node 0 to node 1 has more than two cells, one of them cell 2"):
        CellEdges.of(cells, 8)


@pytest.mark.parametrize(("mesh", "edges"), [(corner(3), 24), (disc(4), 16), (ring(3), 24)])
def test_neighbours_share_an_edge_the_other_way_round(mesh: Mesh, edges: int) -> None:
    links = links_of(mesh.cells, len(mesh.points))
    cells, at = np.nonzero(links.neighbours >= 0)
    for cell, edge in zip(cells, at, strict=True):
        other = links.neighbours[cell, edge]
        back = list(links.neighbours[other]).index(cell)
        assert mesh.cells[cell, edge] == mesh.cells[other, (back + 1) % 4]
        assert mesh.cells[cell, (edge + 1) % 4] == mesh.cells[other, back]
    assert links.boundary().size == edges
    assert np.all(links.neighbours.reshape(-1)[links.boundary()] == -1)


def test_places_name_every_corner_of_a_node() -> None:
    mesh = disc(2)
    links = links_of(mesh.cells, len(mesh.points))
    for node in range(len(mesh.points)):
        places = links.places[links.starts[node] : links.starts[node + 1]]
        assert np.all(mesh.cells.reshape(-1)[places] == node)
    assert links.places.size == mesh.cells.size


def test_edges_of_a_node_are_counter_clockwise_and_begin_at_the_boundary() -> None:
    for mesh, wanted in ((corner(2), {2, 3, 4}), (disc(2), {3, 4}), (ring(2), {3, 4})):
        links, spokes, found = links_of(mesh.cells, len(mesh.points)), np.empty(MAX_SPOKES, dtype=np.int64), set()
        for node in range(len(mesh.points)):
            count, closed = spokes_of(node, links, spokes)
            found.add(count)
            x, y = (mesh.points[spokes[:count]] - mesh.points[node]).T
            turns = (np.diff(np.arctan2(y, x), append=np.arctan2(y[0], x[0])) + 2 * np.pi) % (2 * np.pi)
            assert np.all(turns[: count if closed else -1] < np.pi)
            assert closed == (links.starts[node + 1] - links.starts[node] == count)
            assert (turns.sum() == pytest.approx(2 * np.pi)) or not closed
        assert found - {4} == wanted - {4}


def test_corner_of_a_node() -> None:
    mesh = corner(2)
    assert [corner_at(mesh.cells, 5, node) for node in mesh.cells[5]] == [0, 1, 2, 3]


def placed(mesh: Mesh, points: np.ndarray, beyond: float = 0.0) -> np.ndarray:
    """Where the search places points."""
    found = QuadSearch.of(mesh.points, mesh.cells).find(points[:, 0], points[:, 1], beyond)
    s, t = found.s, found.t
    shape = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=-1)
    return np.einsum("pc,pcd->pd", shape, mesh.points[mesh.cells[found.cell]])


@pytest.mark.parametrize("mesh", [corner(9), bent(disc(8), 0.02), ring(6)])
def test_points_in_cells_are_found_in_any_order(mesh: Mesh) -> None:
    points = inner_points(mesh)
    assert np.abs(placed(mesh, points) - points).max() < 1e-12
    assert np.abs(placed(mesh, mesh.points) - mesh.points).max() < 1e-12


def test_a_point_beyond_the_boundary_has_the_nearest_place_of_it() -> None:
    mesh = corner(8)
    outside = np.array([[1.4, 1.1], [1.05, 1.6], [3.0, 3.0], [-1.0, 0.5], [0.5, -10.0]])
    wanted = np.array([[1.4, 1.0], [1.0, 1.6], [2.0, 1.0], [0.0, 0.5], [0.5, 0.0]])
    assert np.abs(placed(mesh, outside)[:2] - wanted[:2]).max() < 1e-9
    assert np.abs(placed(mesh, outside)[3:] - wanted[3:]).max() < 1e-6
    hole = placed(ring(8), np.array([[0.3, 0.0]]))
    assert np.abs(hole - [[0.5, 0.0]]).max() < 1e-9


def test_places_may_go_on_beyond_a_side() -> None:
    mesh = corner(4)
    points = np.array([[0.3, -0.05], [2.2, 0.4]])
    assert np.abs(placed(mesh, points, 0.25)[0] - points[0]).max() < 1e-12
    assert placed(mesh, points, 0.25)[1, 0] == pytest.approx(2.0625)


def test_no_cell_has_a_point_that_is_not_finite() -> None:
    mesh = disc(3)
    found = QuadSearch.of(mesh.points, mesh.cells).find(np.array([np.nan, 0.1, np.inf]), np.zeros(3))
    assert (found.cell < 0).tolist() == [True, False, True]


def test_the_walk_ends_at_a_hole() -> None:
    mesh = ring(6)
    search = QuadSearch.of(mesh.points, mesh.cells)
    x, y = mesh.points[mesh.cells].mean(axis=1).T
    right = int(np.argmax(x - np.abs(y)))
    assert walk_cells(x[right], y[right], search.nodes, search.links, right - 1) == right
    assert walk_cells(0.1, 0.1, search.nodes, search.links, right) == -1
    assert search_box(x[right], y[right], search.nodes, search.links.cells, search.boxes) == right
    assert search_box(0.0, 0.0, search.nodes, search.links.cells, search.boxes) == -1
    edge = nearest_edge(2.0, 0.01, search.nodes, search.links.cells, search.edges)
    assert mesh.points[mesh.cells[edge // 4]].max() == pytest.approx(1.0)


def test_each_box_has_all_cells_that_meet_it() -> None:
    mesh = bent(disc(6), 0.03)
    boxes = QuadSearch.of(mesh.points, mesh.cells).boxes
    assert 0.5 < boxes.counts.prod() / len(mesh.cells) < 2.0
    for cell, corners in enumerate(mesh.points[mesh.cells]):
        i, j = box_of(*corners.mean(axis=0), boxes)
        box = i * boxes.counts[1] + j
        assert cell in boxes.entries[boxes.starts[box] : boxes.starts[box + 1]]


@pytest.mark.parametrize("mesh", [corner(9), bent(disc(8), 0.02), ring(6)])
def test_places_do_not_depend_on_the_points_before(mesh: Mesh) -> None:
    points = np.concatenate([mesh.points, inner_points(mesh), 1.2 * mesh.points, 0.5 * mesh.points])
    wanted = QuadSearch.of(mesh.points, mesh.cells).find(*points.T)
    for others in (points, points[::-1], points + 0.03, np.full_like(points, np.nan)):
        search = QuadSearch.of(mesh.points, mesh.cells)
        search.find(*others.T)
        for one, other in zip(search.find(*points.T), wanted, strict=True):
            assert one.tobytes() == other.tobytes()


def test_a_place_on_a_slit_does_not_depend_on_the_points_before() -> None:
    below, above = box((0.0, 1.0), (-1.0, 0.0), 4), box((0.0, 1.0), (0.0, 1.0), 4)
    points = np.concatenate([np.column_stack([x.ravel(), y.ravel()]) for x, y in (below, above)])
    cells = np.concatenate([quads_of_block(part) for part in np.arange(50).reshape(2, 5, 5)])
    search, x, y = QuadSearch.of(points, cells), np.array([0.3, 0.6]), np.zeros(2)
    wanted = search.find(x, y).cell
    moved = search.find(x, y + 0.01).cell
    assert (wanted < 16).all()
    assert (moved >= 16).all()
    assert [*search.find(x, y).cell] == [*wanted]
    assert len(search.kept.cells) == 1


def test_a_cell_is_sure_where_no_other_one_holds_the_point() -> None:
    mesh = corner(4)
    search = QuadSearch.of(mesh.points, mesh.cells)
    x, y = mesh.points[mesh.cells].mean(axis=1).T
    first, last = int(np.argmin(x + y)), int(np.argmax(x))
    assert walk_clear(x[last], y[last], search.corners, search.links.neighbours, first, FEW_STEPS) == last
    assert walk_clear(x[last], y[last], search.corners, search.links.neighbours, first, 2) == FAR
    for point in ((0.25, 0.1), (0.25, 0.25), (x[first], 0.0), (0.1, -0.01), (1.3, 1.4)):  # edges, a node, and outside
        assert walk_clear(*point, search.corners, search.links.neighbours, first, FEW_STEPS) == UNCLEAR


def test_the_cells_of_few_calls_are_kept() -> None:
    mesh = disc(3)
    search = QuadSearch.of(mesh.points, mesh.cells)
    for size in range(MAX_CALLS + 9):
        search.find(np.linspace(-0.5, 0.5, size), np.zeros(size))
        assert len(search.kept.cells) <= MAX_CALLS
    assert max(len(cells) for cells in search.kept.cells.values()) == MAX_CALLS + 8
    for size in (MAX_KEPT // 2, MAX_KEPT // 2 + 1, MAX_KEPT + 1):
        search.kept.keep((size, 0, 0), np.zeros(size, dtype=np.int64))
    assert list(search.kept.cells) == [(MAX_KEPT // 2 + 1, 0, 0)]


def nodes_of(mesh: Mesh, block: int, edge: int, first: int, last: int) -> list[int]:
    lines = mesh.blocks[block][0], mesh.blocks[block][-1], mesh.blocks[block][:, 0], mesh.blocks[block][:, -1]
    step = 1 if last > first else -1
    return [int(lines[edge][k]) for k in range(first, last + step, step)]


def interfaces(mesh: Mesh) -> list[tuple[list[int], list[int]]]:
    return [
        (
            nodes_of(mesh, one.block, one.edge, one.first, one.last),
            nodes_of(mesh, one.other, one.other_edge, one.other_first, one.other_last),
        )
        for one in contacts(mesh)
        if one.side is None
    ]


def covered(mesh: Mesh) -> int:
    """The edges of cells that the contacts cover, with those of both blocks of an interface."""
    return sum((one.last - one.first) * (1 if one.side else 2) for one in contacts(mesh))


def test_interfaces_meet_in_the_same_nodes_and_all_edges_are_covered() -> None:
    for mesh in (l_shape(), in_blocks(wavy()).mesh):
        assert all(one == two for one, two in interfaces(mesh))
        assert len(interfaces(mesh)) == len(mesh.blocks) - 1
        assert covered(mesh) == sum(2 * (sum(block.shape) - 2) for block in mesh.blocks)
        for one in contacts(mesh):
            if one.side:
                line = nodes_of(mesh, one.block, one.edge, one.first, one.last)
                of_side = {frozenset(edge) for edge in mesh.sides[one.side].tolist()}
                assert {frozenset(pair) for pair in pairwise(line)} <= of_side


def test_a_turned_block_is_counted_in_the_other_direction() -> None:
    (found,) = [one for one in contacts(in_blocks(wavy()).mesh) if one.side is None]
    assert EDGES[found.edge] == "i_max"
    assert EDGES[found.other_edge].startswith("j")
    assert abs(found.other_last - found.other_first) == found.last - found.first == 8


def test_joined_sides_are_an_interface_of_the_block_with_itself() -> None:
    mesh = channel()
    found = contacts(mesh)
    assert found[0] == Contact(block=0, edge=0, first=0, last=4, other=0, other_edge=1, other_first=0, other_last=4)
    assert [one.side for one in found[1:]] == ["floor", "roof"]


def test_an_edge_may_touch_several_sides() -> None:
    mesh = l_shape()
    wall = mesh.sides["wall"]
    parted = changed(mesh, sides={**mesh.sides, "wall": wall[2:], "valve": wall[:2]})
    along = [(one.first, one.last, one.side) for one in contacts(parted) if (one.block, one.edge) == (0, 2)]
    assert along == [(0, 2, "valve"), (2, 4, "wall")]
    assert np.array_equal(mesh.points, parted.points)
