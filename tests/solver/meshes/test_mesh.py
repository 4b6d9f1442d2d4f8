"""Meshes: numbers of nodes and cells, sides, Jacobians, folds, their data, and cells of nine nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from block_cases import channel, data_of, l_shape
from cases import problem
from equimesh.errors import InputError
from equimesh.io.write import MeshData
from equimesh.meshes.mesh import Grid, Mesh, smallest_jacobian
from equimesh.meshes.second_order import (
    AT_GAUSS_POINTS,
    CurvedEdges,
    SecondOrderMesh,
    corners_of,
    lattice_of,
    nodes_of_cells,
    smallest_shares,
)
from equimesh.numerics.types import Array, IntArray
from equimesh_coupling.elements import places_of_cells
from solver.io.files import DATA

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


def test_smallest_jacobian_is_that_of_the_mesh() -> None:
    mesh = em.solve(problem("paper", 12)).mesh
    assert smallest_jacobian(mesh.x, mesh.y) * 11 * 11 == pytest.approx(mesh.corner_jacobians().min())
    broken = mesh.x.copy()
    broken[3, 4] = np.nan
    assert np.isnan(smallest_jacobian(broken, mesh.y))
    assert em.Mesh(broken, mesh.y).is_folded


class TestTriangles:
    def test_two_for_each_cell_in_order(self) -> None:
        pairs = DATA.triangles().reshape(-1, 6)
        for pair, quad in zip(pairs, DATA.mesh.cells, strict=True):
            assert set(pair) == set(quad)


def test_wrong_shapes() -> None:
    with pytest.raises(InputError, match=r"q_eq has shape \(7, 5\), this mesh needs \(6, 4\)"):
        MeshData(mesh=DATA.mesh, u=DATA.u, q_eq=DATA.u, subdomain=DATA.subdomain)
    with pytest.raises(InputError, match=r"the field rho has shape \(7, 5\), this mesh needs \(6, 4\)"):
        replace(DATA, cell_fields={"rho": DATA.u})
    with pytest.raises(InputError, match=r"the field v has shape \(7, 5, 2, 1\)"):
        replace(DATA, fields={"v": np.zeros((7, 5, 2, 1))})


def test_blocks_have_one_value_for_each_node_and_cell() -> None:
    data = data_of(l_shape())
    with pytest.raises(InputError, match=r"q_eq has shape \(65,\), this mesh needs \(48,\)"):
        replace(data, q_eq=data.u)
    with pytest.raises(InputError, match=r"the field way has shape \(48, 2, 1\), this mesh needs \(48,\)"):
        replace(data, cell_fields={"way": np.zeros((48, 2, 1))})
    for needs_a_grid in ("computational", "grid_mesh"):
        with pytest.raises(InputError, match="this needs a grid, and a mesh of blocks has no rows and columns"):
            getattr(data, needs_a_grid)
    assert DATA.grid_mesh is DATA.mesh


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
    assert corners_of(lattice, 2).distance(grid) == 0.0
    found = lattice_of(blocks)
    assert not found.is_folded
    assert found.cell_areas().reshape(-1, 4).sum(axis=1) == pytest.approx(blocks.cell_areas())
    assert {name: len(edges) for name, edges in found.sides.items()} == {"inlet": 16, "outlet": 8, "wall": 40}
    for mesh in (grid, blocks):
        for degree in (2, 3, 4):
            nodes = lattice_of(mesh, degree).points
            found = nodes[nodes_of_cells(mesh, degree)]
            assert len(np.unique(nodes.round(9), axis=0)) == len(nodes)
            np.testing.assert_allclose(found, places_of_cells(mesh.points[mesh.cells], degree), atol=1e-14)


def test_joined_sides_of_a_lattice_are_joined_in_their_middles_too() -> None:
    mesh = channel()
    for degree in (2, 4):
        ties, points = lattice_of(mesh, degree).ties, lattice_of(mesh, degree).points
        assert len(ties) == degree * (len(mesh.ties) - 1) + 1
        moves = points[ties[:, 0]] - points[ties[:, 1]]
        np.testing.assert_allclose(moves, np.broadcast_to(moves[0], moves.shape), atol=1e-14)
