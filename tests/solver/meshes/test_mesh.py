"""Meshes: numbers of nodes and cells, sides, Jacobians, and folds."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em

GRID = em.Grid(n_xi=5, n_eta=4)


def test_nodes_and_cells_are_numbered_along_eta_first() -> None:
    mesh = em.Mesh.uniform(GRID)
    assert mesh.grid == GRID
    assert mesh.points[2 * 4 + 3].tolist() == [mesh.x[2, 3], mesh.y[2, 3]] == [0.5, 1.0]
    assert mesh.cells.shape == (12, 4)
    assert mesh.cells[1 * 3 + 2].tolist() == [6, 10, 11, 7]


def test_sides_go_around_with_the_domain_on_their_left() -> None:
    mesh = em.Mesh.uniform(GRID)
    around = [tuple(edge) for side in ("bottom", "right", "top", "left") for edge in mesh.sides[side].tolist()]
    assert all(end == start for (_, end), (start, _) in zip(around, around[1:] + around[:1], strict=True))
    x, y = mesh.points.T
    area = sum(x[a] * y[b] - x[b] * y[a] for a, b in around) / 2
    assert area == pytest.approx(1.0)
    assert (x[mesh.sides["right"]] == 1).all()
    assert (y[mesh.sides["bottom"]] == 0).all()


def test_corner_jacobians_are_those_of_the_map_from_the_grid() -> None:
    start = em.Mesh.uniform(GRID)
    assert start.corner_jacobians() == pytest.approx(np.ones((4, 4, 3)))
    sheared = em.Mesh(3 * start.x + start.y, 0.5 * start.y + 0.2 * start.x)
    assert sheared.corner_jacobians() == pytest.approx(np.full((4, 4, 3), 3 * 0.5 - 0.2))
    assert sheared.min_jacobian == pytest.approx(1.3)
    moved = start.x.copy()
    moved[1, 1] += 0.1
    jacobians = em.Mesh(moved, start.y).corner_jacobians()
    assert em.Mesh(moved, start.y).min_jacobian == pytest.approx(jacobians.min()) == pytest.approx(0.6)
    assert {tuple(cell) for _, *cell in np.argwhere(jacobians < 1 - 1e-9).tolist()} == {(1, 0), (1, 1)}


@pytest.mark.parametrize("value", [0.6, 0.5, math.nan, math.inf])
def test_a_node_beyond_the_next_one_folds(value: float) -> None:
    start = em.Mesh.uniform(GRID)
    assert not start.is_folded
    x = start.x.copy()
    x[1, 1] = value  # its neighbour stands at 0.5
    assert em.Mesh(x, start.y).is_folded


def test_the_sides_of_the_unit_square_are_met_exactly() -> None:
    start = em.Mesh.uniform(GRID)
    rounded = em.Mesh.of_unit_square(start.x + 1e-16, start.y - 1e-16)
    assert {*rounded.x[0], *rounded.y[:, 0]} == {0.0}
    assert {*rounded.x[-1], *rounded.y[:, -1]} == {1.0}


def test_coordinates_need_one_shape() -> None:
    for x, y in ((np.zeros((4, 5)), np.zeros((5, 4))), (np.zeros(4), np.zeros(4))):
        with pytest.raises(em.InputError, match="one common shape"):
            em.Mesh(x, y)


def test_ties_of_a_grid_are_pairs_of_its_nodes() -> None:
    start, far = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4)), r"ties\[0\]\[0\] = 20: the nodes have the numbers 0 to 19"
    for ties, words in (([[20, 0]], far), ([[1, 2, 3]], "shape"), ([[1.5, 2.0]], "float64"), ([["a", "b"]], "<U1")):
        with pytest.raises(em.InputError, match=words) as caught:
            em.Mesh(start.x, start.y, ties=np.array(ties))
        assert caught.value.field == "ties"


def test_a_mesh_with_its_nodes_elsewhere_has_arrays_of_its_own() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    moved = mesh.moved(mesh.points + 1.0)
    assert np.array_equal(moved.x, mesh.x + 1.0)
    assert np.array_equal(moved.y, mesh.y + 1.0)
    assert not np.shares_memory(moved.x, mesh.x)
