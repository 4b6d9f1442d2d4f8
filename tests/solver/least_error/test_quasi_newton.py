"""Quasi-Newton directions against dense matrices, and the pairs that are kept."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.least_error.quasi_newton import History, quasi_newton_direction, solve_blocks


def test_blocks_are_solved() -> None:
    rng = np.random.default_rng(3)
    factor, right, out = rng.normal(size=(5, 2, 2)), rng.normal(size=(2, 5)), np.empty((2, 5))
    matrices = factor @ factor.transpose(0, 2, 1) + np.eye(2)
    blocks = np.stack([matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]])
    solve_blocks(blocks, right.reshape(-1), out.reshape(-1))
    assert out == pytest.approx(np.linalg.solve(matrices, right.T[:, :, None])[..., 0].T, rel=1e-12)


@pytest.mark.parametrize("added", [0, 1, 3, 4, 7])
def test_the_direction_is_that_of_dense_bfgs(added: int) -> None:
    # B^-1 := (I - m c^T / p) B^-1 (I - c m^T / p) + m m^T / p for each kept pair, oldest first.
    kept, count, rng = 5, 5, np.random.default_rng(added)
    hessian = (lambda f: f @ f.T + np.eye(10))(rng.normal(size=(10, 10)))
    moves, changes, pairs = np.zeros((kept, 10)), np.zeros((kept, 10)), []
    for number in range(added):
        move = rng.normal(size=10)
        pairs.append((move, hessian @ move))
        moves[number % kept], changes[number % kept] = pairs[-1]
    blocks = np.stack([rng.uniform(2, 3, count), rng.uniform(-1, 1, count), rng.uniform(2, 3, count)])
    dense = np.zeros((10, 10))
    for node in range(count):
        a, b, d = blocks[:, node]
        dense[np.ix_([node, count + node], [node, count + node])] = np.linalg.inv([[a, b], [b, d]])
    if pairs:
        move, change = pairs[-1]
        dense *= (move @ change) / (change @ dense @ change)
    for move, change in pairs[1 - kept :]:
        p = move @ change
        left = np.eye(10) - np.outer(move, change) / p
        dense = left @ dense @ left.T + np.outer(move, move) / p
    gradient, out = rng.normal(size=2 * count), np.empty(2 * count)
    products = (moves * changes).sum(axis=1)
    quasi_newton_direction(moves, changes, products, added, blocks, gradient, out)
    assert out == pytest.approx(dense @ gradient, rel=1e-9)


def test_the_history_keeps_the_last_pairs_of_positive_curvature() -> None:
    rng, blocks = np.random.default_rng(1), np.array([[2.0], [0.0], [2.0]])
    history, gradient = History(2, 8), np.array([[1.0], [3.0]])
    assert history.is_empty
    assert np.array_equal(history.direction(gradient, blocks), gradient / 2)
    nothing = np.zeros((2, 1))
    history.add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[-1.0], [0.0]]))
    history.add(nothing, np.array([[1.0], [0.0]]), nothing, np.array([[0.0], [1.0]]))
    assert history.is_empty
    for _ in range(24):
        move = rng.normal(size=(2, 1))
        before, slope = rng.normal(size=(2, 2, 1))
        change = np.array([[4.0], [9.0]]) * move
        history.add(before, before + move, slope, slope + change)
        history.add(before, before - move, slope, slope + change)  # of negative curvature: not kept
        # The last pair is met exactly: its change of the gradient leads to its move.
        assert history.direction(np.array([[4.0], [9.0]]) * move, blocks) == pytest.approx(move, rel=1e-9)
    history.clear()
    assert history.is_empty
    assert np.array_equal(history.direction(gradient, blocks), gradient / 2)
