"""The loops of the gradient map: nodes from a potential, areas, densities, averages."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh import gradient_map


def nodes(phi: np.ndarray, along: float = 1.0, across: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.empty((phi.shape[0] + 1, phi.shape[1] + 1)), np.empty((phi.shape[0] + 1, phi.shape[1] + 1))
    gradient_map.move_nodes(phi, along, across, x, y)
    return x, y


def potential(cells_xi: int, cells_eta: int) -> np.ndarray:
    s = (np.arange(cells_xi)[:, None] + 0.5) / cells_xi
    t = (np.arange(cells_eta) + 0.5) / cells_eta
    result: np.ndarray = 0.02 * np.cos(np.pi * s) * np.cos(2 * np.pi * t)
    return result


def test_nodes_move_by_the_gradient() -> None:
    x, y = nodes(potential(60, 90), along=2.0, across=0.5)
    s, t = np.meshgrid(np.linspace(0, 1, 61), np.linspace(0, 1, 91), indexing="ij")
    by_s = -0.02 * np.pi * np.sin(np.pi * s) * np.cos(2 * np.pi * t)
    by_t = -0.04 * np.pi * np.cos(np.pi * s) * np.sin(2 * np.pi * t)
    assert np.abs(x - s - 2.0 * by_s).max() < 2e-3 * 2.0 * np.abs(by_s).max()
    assert np.abs(y - t - 0.5 * by_t).max() < 2e-3 * 0.5 * np.abs(by_t).max()


def test_nodes_stay_on_their_sides() -> None:
    x, y = nodes(np.random.default_rng(0).normal(size=(7, 5)))
    assert np.array_equal(x[[0, -1]], [[0.0] * 6, [1.0] * 6])
    assert np.array_equal(y[:, [0, -1]].T, [[0.0] * 8, [1.0] * 8])


def test_a_chess_board_moves_no_node() -> None:
    board = (-1.0) ** (np.arange(6)[:, None] + np.arange(8))
    for moved, flat in zip(nodes(board)[:2], nodes(np.zeros((6, 8))), strict=True):
        inner = (slice(1, -1), slice(1, -1))
        assert np.allclose(moved[inner], flat[inner], atol=1e-15)


def test_areas_fill_the_square_and_folds_have_a_negative_jacobian() -> None:
    x, y = nodes(potential(12, 9))
    area = np.empty((12, 9))
    smallest = gradient_map.measure_cells(x, y, area)
    assert area.mean() == pytest.approx(1.0, rel=1e-13)
    assert 0.0 < smallest < area.min()
    x[6, 4] = x[8, 4]
    assert gradient_map.measure_cells(x, y, area) < 0.0
    x[6, 4] = np.nan
    assert np.isnan(gradient_map.measure_cells(x, y, area))


def test_the_smallest_jacobian_is_that_of_any_corner() -> None:
    s, t = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 4), indexing="ij")
    for seed in range(20):
        x, y = (q + 0.1 * np.random.default_rng((seed, k)).normal(size=(4, 4)) for k, q in enumerate((s, t)))
        expected = em.Mesh(x, y).min_jacobian
        assert gradient_map.measure_cells(x, y, np.empty((3, 3))) == pytest.approx(expected, rel=1e-12), seed


def test_densities_are_read_at_the_centres_of_cells() -> None:
    table = np.add.outer(2.0 * np.linspace(0, 1, 9), 3.0 * np.linspace(0, 1, 5))
    x, y = nodes(potential(6, 7))
    out = np.empty((6, 7))
    gradient_map.look_up(table, x, y, out)
    middle = [0.25 * (q[1:, 1:] + q[:-1, 1:] + q[1:, :-1] + q[:-1, :-1]) for q in (x, y)]
    assert np.allclose(out, 2.0 * middle[0] + 3.0 * middle[1], rtol=1e-13)


@pytest.mark.parametrize("mirrored", [False, True])
def test_an_average_keeps_the_integral_and_is_local(mirrored: bool) -> None:
    values = np.random.default_rng(1).random((8, 6))
    weights = np.ones((8, 6))
    if mirrored:  # values at nodes: those on the sides count half
        weights[[0, -1]] *= 0.5
        weights[:, [0, -1]] *= 0.5
    before = float((weights * values).sum())
    spike = np.zeros((8, 6))
    spike[4, 3] = 1.0
    for field in (values, spike):
        gradient_map.average(field, np.empty((8, 6)), mirrored)
    assert float((weights * values).sum()) == pytest.approx(before, rel=1e-13)
    assert spike[3:6, 2:5].tolist() == [[1 / 16, 1 / 8, 1 / 16], [1 / 8, 1 / 4, 1 / 8], [1 / 16, 1 / 8, 1 / 16]]


def test_the_inner_product() -> None:
    one, other = np.random.default_rng(2).random((2, 5, 4))
    assert gradient_map.product(one, other) == pytest.approx(float((one * other).sum()), rel=1e-14)
