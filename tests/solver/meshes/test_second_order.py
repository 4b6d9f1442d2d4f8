"""Cells of nine nodes: their places, and sides that bend."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import channel, l_shape
from equimesh.errors import InputError
from equimesh.meshes.mesh import Grid, Mesh
from equimesh.meshes.second_order import (
    AT_GAUSS_POINTS,
    CurvedEdges,
    SecondOrderMesh,
    every_second,
    lattice_of,
    nodes_of_cells,
    smallest_shares,
)
from equimesh.numerics.types import Array, IntArray


def layers(*heights: float, sagitta: float) -> tuple[Array, IntArray, CurvedEdges]:
    """Two columns of cells of width 1 on a floor that bends upwards between the nodes."""
    x, y = np.meshgrid(np.arange(3.0), [0.0, *heights], indexing="ij")
    mesh = Mesh(x, y)
    floor = mesh.sides["bottom"]
    middles = mesh.points[floor].mean(axis=1) + np.array([0.0, sagitta])
    return mesh.points, mesh.cells, CurvedEdges(floor, middles)


def test_nodes_between_straight_edges_are_those_of_the_bilinear_map() -> None:
    mesh = l_shape()
    second = SecondOrderMesh.of(mesh.points, mesh.cells)
    at = mesh.points[mesh.cells]
    np.testing.assert_array_equal(second.points[second.cells[:, :4]], at)
    np.testing.assert_allclose(second.points[second.cells[:, 4:8]], 0.5 * (at + np.roll(at, -1, axis=1)), atol=1e-15)
    np.testing.assert_allclose(second.points[second.cells[:, 8]], at.mean(axis=1), atol=1e-15)
    assert np.array_equal(np.unique(second.cells), np.arange(len(second.points)))  # each node once, none without a cell


def test_edges_are_found_in_either_direction_and_have_their_middle() -> None:
    mesh = l_shape()
    second = SecondOrderMesh.of(mesh.points, mesh.cells)
    wall = mesh.sides["wall"]
    found = second.edges(wall)
    np.testing.assert_array_equal(found[:, :2], wall)
    np.testing.assert_allclose(second.points[found[:, 2]], mesh.points[wall].mean(axis=1), atol=1e-15)
    np.testing.assert_array_equal(second.edges(wall[:, ::-1])[:, 2], found[:, 2])


def test_triangles_have_the_same_nodes_and_meet_in_the_centre() -> None:
    mesh = l_shape()
    second = SecondOrderMesh.of(mesh.points, mesh.cells)
    triangles = second.triangles(mesh.triangles())
    corners = second.points[triangles[:, :3]]
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
    is_centre = np.isin(triangles[:, 3:], second.cells[:, 8])
    np.testing.assert_array_equal(is_centre.sum(axis=1), 1)
    np.testing.assert_allclose(second.points[triangles[:, 3:]][~is_centre], middles[~is_centre], atol=1e-15)
    centres = np.sort(triangles[:, 3:][is_centre].reshape(-1, 2), axis=1)
    np.testing.assert_array_equal(centres, np.column_stack([second.cells[:, 8]] * 2))


def test_values_between_are_means_so_that_linear_ones_stay() -> None:
    mesh = l_shape()
    second = SecondOrderMesh.of(mesh.points, mesh.cells)
    np.testing.assert_allclose(second.at_nodes(mesh.points @ [2.0, -1.0]), second.points @ [2.0, -1.0], atol=1e-14)


def test_edges_inside_stay_straight_where_cells_are_thick() -> None:
    points, cells, curved = layers(0.5, 1.0, sagitta=0.1)
    second = SecondOrderMesh.of(points, cells, curved)
    np.testing.assert_array_equal(second.points[second.edges(curved.edges)[:, 2]], curved.middles)
    inner = second.edges(np.array([[1, 4], [4, 7]]))
    np.testing.assert_allclose(second.points[inner[:, 2], 1], 0.5)
    # the centre of a blended map lies half as far from the chord as the middle of the bent edge
    np.testing.assert_allclose(second.points[second.cells[[0, 2], 8], 1], 0.25 + 0.05)


def test_edges_bend_with_the_side_as_far_as_cells_would_fold() -> None:
    points, cells, curved = layers(0.02, 0.05, 0.5, 1.0, sagitta=0.1)
    second = SecondOrderMesh.of(points, cells, curved)
    lines = second.edges(np.array([[k, k + 5] for k in range(5)]))
    bends = second.points[lines[:, 2], 1] - [0.0, 0.02, 0.05, 0.5, 1.0]
    np.testing.assert_allclose(bends, [0.1, 0.1, 0.1, 0.0, 0.0], atol=1e-15)
    corners = second.points[second.cells[:, :4]]
    moves = second.points[second.cells[:, 4:8]] - 0.5 * (corners + np.roll(corners, -1, axis=1))
    assert smallest_shares(corners, moves, AT_GAUSS_POINTS).min() > 0.0
    assert smallest_shares(corners[:1], moves[:1] * [[[1.0], [1.0], [0.0], [1.0]]], AT_GAUSS_POINTS)[0] < 0.0


def test_a_straight_side_stays_where_it_is() -> None:
    points, cells, curved = layers(0.1, sagitta=0.09)
    second = SecondOrderMesh.of(points, cells, curved)
    ceiling = second.edges(np.array([[1, 3], [3, 5]]))
    np.testing.assert_array_equal(second.points[ceiling[:, 2], 1], 0.1)
    points, cells, curved = layers(0.02, sagitta=0.1)
    with pytest.raises(InputError, match="folds where its side bends"):
        SecondOrderMesh.of(points, cells, curved)


def test_a_cell_that_folds_all_the_same_is_refused() -> None:
    points, cells, curved = layers(0.02, sagitta=0.1)
    ceiling = CurvedEdges(np.array([[1, 3], [3, 5]]), np.array([[0.5, 0.02], [1.5, 0.02]]))
    both = CurvedEdges(
        np.concatenate([curved.edges, ceiling.edges]), np.concatenate([curved.middles, ceiling.middles - 0.01])
    )
    with pytest.raises(
        InputError, match=r"the cell around \(0\.5, 0\.01\) folds where its side bends: take more"
    ) as error:
        SecondOrderMesh.of(points, cells, both)
    assert error.value.field == "order"


def test_a_lattice_has_four_cells_in_the_place_of_each() -> None:
    grid, blocks = Mesh.uniform(Grid(n_xi=4, n_eta=5)), l_shape()
    lattice = lattice_of(grid)
    assert lattice.distance(Mesh.uniform(Grid(n_xi=7, n_eta=9))) < 1e-15
    assert every_second(lattice).distance(grid) == 0.0
    found = lattice_of(blocks)
    assert not found.is_folded
    assert found.cell_areas().reshape(-1, 4).sum(axis=1) == pytest.approx(blocks.cell_areas())
    assert {name: len(edges) for name, edges in found.sides.items()} == {"inlet": 16, "outlet": 8, "wall": 40}
    for mesh in (grid, blocks):
        numbers, nodes = nodes_of_cells(mesh), lattice_of(mesh).points
        np.testing.assert_allclose(nodes[numbers[:, [0, 2, 2, 0], [0, 0, 2, 2]]], mesh.points[mesh.cells], atol=1e-15)
        np.testing.assert_allclose(nodes[numbers[:, 1, 1]], mesh.points[mesh.cells].mean(axis=1), atol=1e-15)


def test_joined_sides_of_a_lattice_are_joined_in_their_middles_too() -> None:
    mesh = channel()
    ties = lattice_of(mesh).ties
    assert len(ties) == 2 * len(mesh.ties) - 1
    points = lattice_of(mesh).points
    moves = points[ties[:, 0]] - points[ties[:, 1]]
    np.testing.assert_allclose(moves, np.broadcast_to(moves[0], moves.shape), atol=1e-14)
