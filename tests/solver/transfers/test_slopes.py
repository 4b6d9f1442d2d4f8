"""Limited slopes, bounds, and the integrals that are kept."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.meshes.cell_edges import links_of
from equimesh.meshes.mesh import Mesh
from equimesh.transfers.integrals import Cells, measures_of, total, untied
from equimesh.transfers.overlaps import Overlaps
from equimesh.transfers.repair import give_around, nodes_around, repair, share_out
from equimesh.transfers.slopes import (
    continue_beyond,
    edge_to,
    gradient,
    limit_nodes,
    limiter,
    slopes_of_averages,
    slopes_of_nodes,
)
from equimesh.transfers.transfer import transfer_averages
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, strip
from solver.transfers.cases import averages, fronts

CELLS, SHAPE = Cells.of(smooth_mesh(9)), smooth_mesh(9).cell_shape


def at_corners(cells: Cells, means: np.ndarray, slopes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    x, y = cells.corners
    return means[:, None] + slopes[0][:, None] * (x - cells.x[:, None]) + slopes[1][:, None] * (y - cells.y[:, None])


def test_linear_functions_are_exact_where_bounds_allow_it() -> None:
    means = 2.0 * CELLS.x - CELLS.y
    (gx, gy), _ = slopes_of_averages(CELLS, means, -10.0, 10.0)
    inner = (slice(2, -2), slice(2, -2))  # at the sides a line of centroids that bends leads to slightly tighter bounds
    for slope, exact in ((gx, 2.0), (gy, -1.0)):
        assert np.abs(slope.reshape(SHAPE)[inner] - exact).max() < 1e-12
        assert np.abs(slope - exact).max() < 0.02
    nodal = np.sum(np.array([2.0, -1.0])[:, None, None] * CELLS.corners, axis=0)
    gx, gy = slopes_of_nodes(CELLS, nodal, means)
    assert np.abs(gx - 2.0).max() < 1e-12
    assert np.abs(gy + 1.0).max() < 1e-12


def test_at_straight_sides_linear_functions_need_room() -> None:
    cells = Cells.of(em.Mesh.uniform(em.Grid(n_xi=9, n_eta=17)))
    means = 1.0 + 2.0 * cells.x - 3.0 * cells.y
    wide, _ = slopes_of_averages(cells, means, -10.0, 10.0)
    tight, _ = slopes_of_averages(cells, means, means.min(), means.max())
    for slopes, exact in zip(zip(wide, tight, strict=True), (2.0, -3.0), strict=True):
        assert np.abs(slopes[0] - exact).max() < 1e-12
        reduced = np.abs(slopes[1] - exact).reshape(8, 16) > 1e-12
        assert reduced[0, -1]  # the least average
        assert reduced[-1, 0]  # the largest one
        assert not reduced[1:-1, 1:-1].any()


def test_values_at_corners_stay_within_the_bounds() -> None:
    means = np.random.default_rng(1).uniform(0.0, 1.0, CELLS.area.size)
    slopes, (low, high) = slopes_of_averages(CELLS, means, 0.0, 1.0)
    values = at_corners(CELLS, means, slopes)
    assert np.all(values >= low[:, None] - 1e-14)
    assert np.all(values <= high[:, None] + 1e-14)
    assert low.min() >= 0.0
    assert high.max() <= 1.0
    nodal = np.random.default_rng(2).uniform(0.0, 1.0, (CELLS.area.size, 4))
    means = np.sum(CELLS.weights * nodal, axis=1) / CELLS.area
    values = at_corners(CELLS, means, slopes_of_nodes(CELLS, nodal, means))
    assert np.all(values >= nodal.min(axis=1)[:, None] - 1e-14)
    assert np.all(values <= nodal.max(axis=1)[:, None] + 1e-14)


def test_a_gradient_needs_two_directions() -> None:
    assert gradient(1.0, 0.0, 2.0, 1.0, 1.0, 5.0) == (2.0, 3.0)
    assert gradient(1.0, 0.0, 2.0, 2.0, 0.0, 4.0) == (0.0, 0.0)


def test_the_limiter_is_the_largest_factor() -> None:
    x, y = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    assert limiter(0.5, 1.0, 0.0, (x, y), (0.0, 0.0), np.array([0.0, 2.0])) == 0.5
    assert limiter(0.5, 0.1, 0.0, (x, y), (0.0, 0.0), np.array([0.0, 2.0])) == 1.0


def test_the_loops_fill_in_all_cells() -> None:
    slopes = np.full((2, CELLS.area.size), np.nan)
    ones = np.ones((CELLS.area.size, 4))
    limit_nodes((CELLS.x, CELLS.y), ones[:, 0].copy(), ones, CELLS.corners, (slopes[0], slopes[1]))
    assert not slopes.any()


# Limited slopes on the cells of blocks.


@pytest.mark.parametrize("mesh", [corner(5), bent(disc(5), 0.02)])
def test_linear_functions_have_exact_slopes_inside(mesh: Mesh) -> None:
    cells = Cells.of(mesh)
    (g, h), _ = slopes_of_averages(cells, 2 * cells.x - cells.y, -9.0, 9.0)
    exact = (np.abs(g - 2) < 1e-9) & (np.abs(h + 1) < 1e-9)
    assert exact[(cells.links.neighbours >= 0).all(axis=1)].mean() > 0.9


def test_values_go_on_beyond_sides_and_joins() -> None:
    cells = Cells.of(strip(5))
    beyond = np.empty((3, 25, 4))
    continue_beyond(cells.links, (cells.x, cells.y), cells.y**2, cells.corners, beyond)
    column = cells.y[:5]
    assert beyond[2, 4, 2] == pytest.approx(column[4] ** 2 + column[3] ** 2 - column[2] ** 2)
    assert np.allclose(beyond[:2, 4, 2], [0.1, 1.1])
    assert np.allclose(beyond[0, :5, 3], -0.1)  # through the join, translated
    assert np.allclose(beyond[2, :5, 3], column**2)
    assert edge_to(cells.links.neighbours, 5, 0) == 3


def test_slopes_keep_the_bounds_at_the_corners() -> None:
    cells = Cells.of(bent(disc(6), 0.02))
    averages = (cells.x > 0.1).astype(float)
    (g, h), (low, high) = slopes_of_averages(cells, averages, 0.0, 1.0)
    at = (
        averages[:, None]
        + g[:, None] * (cells.corners[0] - cells.x[:, None])
        + h[:, None] * (cells.corners[1] - cells.y[:, None])
    )
    assert np.all((at >= low[:, None] - 1e-12) & (at <= high[:, None] + 1e-12))
    assert (low.min(), high.max()) == (0.0, 1.0)


def test_one_row_of_cells_has_slopes_along_it() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 6), [0.0, 0.1], indexing="ij")
    grid = em.Mesh(x, y)
    cells = Cells.of(Mesh(points=grid.points, cells=grid.cells, sides={}))
    (g, h), _ = slopes_of_averages(cells, 3 * cells.x, -9.0, 9.0)
    assert np.allclose(g, 3.0)
    assert np.allclose(h, 0.0)


LINKS = links_of(em.Mesh.uniform(em.Grid(n_xi=12, n_eta=9)).cells, 108)


def test_what_is_beyond_a_bound_moves_to_neighbours() -> None:
    rng = np.random.default_rng(5)
    weights, values = rng.uniform(0.5, 2.0, 108), rng.uniform(-0.2, 1.2, 108)
    before = np.sum(weights * values)
    repair(values, weights, np.zeros(108), np.ones(108), LINKS)
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert np.sum(weights * values) == pytest.approx(before, abs=1e-13)


def test_values_within_bounds_stay() -> None:
    values = np.linspace(0.0, 1.0, 108)
    same = values.copy()
    repair(values, np.ones(108), np.zeros(108), np.ones(108), LINKS)
    assert np.array_equal(values, same)


@pytest.mark.parametrize(("aim", "reached"), [(6.0, 6.0), (1.0, 1.0), (50.0, 10.0), (-3.0, 0.0)])
def test_a_sum_is_reached_as_far_as_bounds_allow(aim: float, reached: float) -> None:
    values = np.linspace(0.0, 1.0, 10)
    share_out(values, np.ones(10), np.zeros(10), np.ones(10), aim)
    assert values.sum() == pytest.approx(reached, abs=1e-13)
    assert values.min() >= 0.0
    assert values.max() <= 1.0


# What is beyond a bound moves to the nodes around.


def test_the_excess_finds_room_around_and_the_sum_stays() -> None:
    cells = Cells.of(disc(5))
    weights, values = cells.node_weights, np.full(cells.nodes, 0.5)
    node = int(np.argmin(np.hypot(disc(5).x, disc(5).y)))
    values[node] = 1.5
    before, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    assert give_around(values, weights, (low, high), cells.links)
    assert (values[node], (values != 0.5).sum()) == (1.0, 9)
    assert weights @ values == pytest.approx(before, abs=1e-15)
    assert not give_around(values, weights, (low, high), cells.links)


def test_a_repair_ends_within_the_bounds() -> None:
    cells = Cells.of(disc(6))
    weights, rng = cells.node_weights, np.random.default_rng(1)
    values = rng.uniform(-0.4, 1.4, cells.nodes)
    aim, low, high = weights @ values, np.zeros(values.size), np.ones(values.size)
    repair(values, weights, low, high, cells.links)
    assert 0.0 <= values.min() <= values.max() <= 1.0
    assert weights @ values == pytest.approx(aim, abs=1e-14)


def test_nodes_around_are_counted_once() -> None:
    cells = Cells.of(disc(3))
    seen, ring = np.full(cells.nodes[0], -1), np.empty(cells.nodes[0], dtype=np.int64)
    counts = [nodes_around(node, cells.links, seen, ring) for node in range(cells.nodes[0])]
    assert set(counts) == {6, 7, 9}  # at the boundary, where three cells meet, elsewhere
    assert counts.count(7) == 4


def test_the_integral_of_nodal_values_is_that_of_the_bilinear_function() -> None:
    skfem = pytest.importorskip("skfem")
    mesh = smooth_mesh(9)
    values = np.random.default_rng(3).uniform(-1.0, 1.0, mesh.x.shape)
    basis = skfem.Basis(skfem.MeshQuad(mesh.points.T, mesh.cells.T), skfem.ElementQuad1())
    exact = skfem.Functional(lambda w: w["u"]).assemble(basis, u=basis.interpolate(values.reshape(-1)))
    assert em.integral(mesh, values) == pytest.approx(float(exact), abs=1e-14)


def test_areas_and_centroids_are_exact() -> None:
    cells = Cells.of(smooth_mesh(9))
    for values, function in ((cells.x, lambda x, y: x + 0 * y), (cells.y, lambda x, y: y + 0 * x)):
        assert np.abs(values - averages(smooth_mesh(9), function).reshape(-1)).max() < 1e-15
    assert total(cells.area, np.ones(cells.area.size)) == pytest.approx(1.0, abs=1e-15)
    assert cells.node_weights.sum() == pytest.approx(1.0, abs=1e-14)
    assert np.all(cells.weights > 0.0)
    nodal = np.arange(9 * 12, dtype=float)
    assert cells.at_corners(nodal)[0].tolist() == [0.0, 12.0, 13.0, 1.0]


def test_values_of_another_shape_are_refused() -> None:
    assert em.integral(smooth_mesh(9), np.ones((8, 11)), "cells") == pytest.approx(1.0)
    with pytest.raises(SamplesError, match=r"a value at each node is needed, shape \(9, 12\), xi first$"):
        em.integral(smooth_mesh(9), np.ones((8, 11)))


# Averages over cells: integrals to rounding, bounds, and the order.


def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sin(3.0 * x + y) * np.exp(0.5 * y)


def test_the_error_is_of_order_2() -> None:
    errors = []
    for n in (17, 33, 65):
        overlaps = Overlaps.of(smooth_mesh(n), smooth_mesh(n, depth=0.03))
        moved = transfer_averages(overlaps, averages(smooth_mesh(n), wave).reshape(-1))
        error = moved - averages(smooth_mesh(n, depth=0.03), wave).reshape(-1)
        errors.append([total(overlaps.new.area, np.abs(error)), np.sqrt(total(overlaps.new.area, error**2))])
    assert np.all(np.log2(np.array(errors[1]) / errors[2]) > 2.0), errors
    assert errors[2][0] < 3e-5


@pytest.mark.parametrize("seed", range(3))
def test_integral_and_bounds_hold_for_anything(seed: int) -> None:
    rng, (old, new) = np.random.default_rng(seed), fronts()
    overlaps = Overlaps.of(old, new)
    values = rng.integers(0, 2, overlaps.old.area.size).astype(float) + rng.uniform(1e3, 1e4)
    moved = transfer_averages(overlaps, values)
    assert moved.min() >= values.min()
    assert moved.max() <= values.max()
    assert total(overlaps.new.area, moved) == pytest.approx(total(overlaps.old.area, values), rel=1e-14)


def test_the_integral_is_kept_by_the_parts_and_not_only_by_sharing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("equimesh.transfers.transfer.share_out", lambda *_: None)
    overlaps = Overlaps.of(*fronts())
    values = np.random.default_rng(9).uniform(0.0, 1.0, overlaps.old.area.size)
    moved = transfer_averages(overlaps, values)
    assert total(overlaps.new.area, moved) == pytest.approx(total(overlaps.old.area, values), rel=1e-13)


def test_given_bounds_leave_room_at_the_sides() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=9))
    new = em.Mesh(uniform.x**2, uniform.y)  # its first column is thinner
    overlaps = Overlaps.of(uniform, new)
    exact = Cells.of(new).x
    assert np.abs(transfer_averages(overlaps, overlaps.old.x, (0.0, 1.0)) - exact).max() < 1e-14
    assert np.abs(transfer_averages(overlaps, overlaps.old.x) - exact).max() > 0.01


# Areas, centroids and weights of corners.


def test_a_trapezium() -> None:
    found = measures_of(np.array([[[0.0, 2.0, 1.0, 0.0]], [[0.0, 0.0, 1.0, 1.0]]]))
    assert found.area[0] == 1.5
    assert (found.x[0], found.y[0]) == (pytest.approx(7 / 9), pytest.approx(4 / 9))
    assert found.weights.sum() == pytest.approx(1.5)
    # The integral of a linear function by its corners is that of the centroid.
    assert found.weights[0] @ [0.0, 2.0, 1.0, 0.0] == pytest.approx(1.5 * 7 / 9)
    assert found.weights[0] @ [0.0, 0.0, 1.0, 1.0] == pytest.approx(1.5 * 4 / 9)


# Sums at the nodes and corners of blocks, with tied nodes as one.


def test_sums_and_extremes_around_nodes() -> None:
    grid = smooth_mesh(7)
    cells, nodal = Cells.of(grid), np.sin(grid.x).reshape(-1)
    assert np.array_equal(cells.at_corners(nodal), nodal[grid.cells])
    assert np.abs(cells.at_nodes(np.ones((len(grid.cells), 4))).reshape(grid.node_shape)[1:-1, 1:-1] - 4.0).max() == 0.0
    area = cells.area.reshape(grid.cell_shape)
    for extreme in (np.minimum, np.maximum):
        found = cells.around_nodes(cells.area, extreme).reshape(grid.node_shape)
        assert found[2, 3] == extreme.reduce(area[1:3, 2:4].ravel())
    assert (cells.shape, cells.nodes) == ((len(grid.cells),), (nodal.size,))


def test_tied_nodes_are_one_node() -> None:
    mesh = strip(4)
    cells = Cells.of(mesh)
    assert cells.nodes == (20,)
    assert cells.node_weights.sum() == pytest.approx(1.0)
    assert np.allclose(cells.node_weights.reshape(4, 5)[:, 2], 1 / 16)
    assert np.all(cells.links.neighbours.reshape(4, 4, 4)[:, 1:-1] >= 0)
    assert untied(disc(2))[0].size == len(disc(2).points)


def test_a_copy_of_a_copy_is_the_same_node() -> None:
    mesh = strip(3, both=True)
    kept, number = untied(mesh)
    assert kept.size == 9
    assert number[[0, 3, 12, 15]].tolist() == [0, 0, 0, 0]
