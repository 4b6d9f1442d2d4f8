"""Limited slopes: exact for linear functions, and within the bounds of the neighbours."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.transfers.integrals import Cells
from equimesh.transfers.slopes import (
    continue_beyond,
    edge_to,
    gradient,
    limit_nodes,
    limiter,
    slopes_of_averages,
    slopes_of_nodes,
)
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, strip

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
