"""The cells of points: around corners and holes, outside, and after long ways."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.meshes.mesh import Mesh
from equimesh.meshes.quad_search import (
    FAR,
    FEW_STEPS,
    MAX_CALLS,
    UNCLEAR,
    QuadSearch,
    box_of,
    nearest_edge,
    search_box,
    walk_cells,
    walk_clear,
)
from solver.meshes.quad_cases import bent, corner, disc, inner_points, ring


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


def test_a_cell_is_sure_where_no_other_one_holds_the_point() -> None:
    mesh = corner(4)
    search = QuadSearch.of(mesh.points, mesh.cells)
    x, y = mesh.points[mesh.cells].mean(axis=1).T
    first, last = int(np.argmin(x + y)), int(np.argmax(x))
    assert walk_clear(x[last], y[last], search.corners, search.links.neighbours, first, FEW_STEPS) == last
    assert walk_clear(x[last], y[last], search.corners, search.links.neighbours, first, 2) == FAR
    assert walk_clear(x[first], 0.0, search.corners, search.links.neighbours, first, FEW_STEPS) == first
    for point in ((0.25, 0.1), (0.25, 0.25), (0.1, -0.01), (1.3, 1.4)):  # an edge, a node, and outside
        assert walk_clear(*point, search.corners, search.links.neighbours, first, FEW_STEPS) == UNCLEAR


def test_the_cells_of_few_calls_are_kept() -> None:
    mesh = disc(3)
    search = QuadSearch.of(mesh.points, mesh.cells)
    for size in range(90):
        search.find(np.linspace(-0.5, 0.5, size), np.zeros(size))
        assert len(search.before) <= MAX_CALLS
    assert max(len(cells) for cells in search.before.values()) == 89
