"""Half-edges: which cells meet, and what is said of meshes whose cells do not meet well."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.recovery.half_edges import HalfEdges, counter_clockwise
from equimesh.errors import InputError
from solver.blocks.recovery.meshes import boundary_of, disc, grid, ring, without


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
