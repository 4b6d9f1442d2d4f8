"""Limited slopes: exact for linear functions, and within the bounds of the neighbours."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.transfers.integrals import Cells, cells_of
from equimesh.transfers.slopes import (
    continue_beyond,
    continue_line,
    gradient,
    limit_averages,
    limit_nodes,
    limiter,
    slopes_of_averages,
    slopes_of_nodes,
)
from solver.fields.bent_meshes import smooth_mesh

CELLS = cells_of(smooth_mesh(9))


def at_corners(cells: Cells, means: np.ndarray, slopes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    x, y = cells.corners
    return means[:, None] + slopes[0][:, None] * (x - cells.x[:, None]) + slopes[1][:, None] * (y - cells.y[:, None])


def test_linear_functions_are_exact_where_bounds_allow_it() -> None:
    means = 2.0 * CELLS.x - CELLS.y
    (gx, gy), _ = slopes_of_averages(CELLS, means, -10.0, 10.0)
    inner = (slice(2, -2), slice(2, -2))  # at the sides a line of centroids that bends leads to slightly tighter bounds
    for slope, exact in ((gx, 2.0), (gy, -1.0)):
        assert np.abs(slope.reshape(CELLS.shape)[inner] - exact).max() < 1e-12
        assert np.abs(slope - exact).max() < 0.02
    nodal = np.sum(np.array([2.0, -1.0])[:, None, None] * CELLS.corners, axis=0)
    gx, gy = slopes_of_nodes(CELLS, nodal, means)
    assert np.abs(gx - 2.0).max() < 1e-12
    assert np.abs(gy + 1.0).max() < 1e-12


def test_at_straight_sides_linear_functions_need_room() -> None:
    cells = cells_of(em.Mesh.uniform(em.Grid(n_xi=9, n_eta=17)))
    means = 1.0 + 2.0 * cells.x - 3.0 * cells.y
    wide, _ = slopes_of_averages(cells, means, -10.0, 10.0)
    tight, _ = slopes_of_averages(cells, means, means.min(), means.max())
    for slopes, exact in zip(zip(wide, tight, strict=True), (2.0, -3.0), strict=True):
        assert np.abs(slopes[0] - exact).max() < 1e-12
        reduced = np.abs(slopes[1] - exact).reshape(cells.shape) > 1e-12
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


def test_beyond_a_side_a_jump_is_not_continued() -> None:
    x, y, values = np.arange(7.0), np.zeros(7), np.array([0.0, 1.0, 0.0, 0.0, 2.0, 3.0, 0.0])
    continue_line(values, x, y)
    assert values.tolist() == [1.0, 1.0, 0.0, 0.0, 2.0, 3.0, 4.0]
    padded = np.ones((6, 7))
    continue_beyond(padded, *np.meshgrid(np.arange(6.0), np.arange(7.0), indexing="ij"))
    assert np.all(padded == 1.0)


def test_a_gradient_needs_two_directions() -> None:
    assert gradient(1.0, 0.0, 2.0, 1.0, 1.0, 5.0) == (2.0, 3.0)
    assert gradient(1.0, 0.0, 2.0, 2.0, 0.0, 4.0) == (0.0, 0.0)


def test_the_limiter_is_the_largest_factor() -> None:
    x, y = np.array([-1.0, 1.0, 1.0, -1.0]), np.array([-1.0, -1.0, 1.0, 1.0])
    assert limiter(0.5, 1.0, 0.0, (x, y), (0.0, 0.0), np.array([0.0, 2.0])) == 0.5
    assert limiter(0.5, 0.1, 0.0, (x, y), (0.0, 0.0), np.array([0.0, 2.0])) == 1.0


def test_the_loops_fill_in_all_cells() -> None:
    empty = [np.full(CELLS.area.size, np.nan) for _ in range(4)]
    padded, (x, y) = (
        np.ones((CELLS.shape[0] + 2, CELLS.shape[1] + 2)),
        np.meshgrid(np.arange(CELLS.shape[0] + 2.0), np.arange(CELLS.shape[1] + 2.0), indexing="ij"),
    )
    limit_averages((x, y), padded, CELLS.corners, (0.0, 1.0), (empty[0], empty[1]), (empty[2], empty[3]))
    assert not np.isnan(empty).any()
    slopes = np.full((2, CELLS.area.size), np.nan)
    ones = np.ones((CELLS.area.size, 4))
    limit_nodes((CELLS.x, CELLS.y), ones[:, 0].copy(), ones, CELLS.corners, (slopes[0], slopes[1]))
    assert not slopes.any()
