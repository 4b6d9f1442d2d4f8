"""Nodes between four sides."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.initial import transfinite


def test_a_skew_block_with_graded_sides_is_met_exactly() -> None:
    bottom, top = np.array([0.0, 0.2, 0.5, 1.0]), np.array([0.0, 0.4, 0.7, 1.0])
    left = np.array([0.0, 0.3, 1.0])

    def at(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        u, v = np.broadcast_arrays(u, v)
        return np.stack([2 * u + 0.3 * v, v + 0.5 * u], axis=-1)

    sides = at(np.zeros(3), left), at(np.ones(3), left), at(bottom, np.zeros(4)), at(top, np.ones(4))
    found = transfinite(sides, (left, left, bottom, top))
    assert found.shape == (4, 3, 2)
    assert found == pytest.approx(at(bottom[:, None] + left * (top - bottom)[:, None], left[None, :]))


def test_sides_are_kept_to_the_bit() -> None:
    rng = np.random.default_rng(1)
    shares = np.array([0.0, 0.4, 1.0])
    corner = {(i, j): np.array([i, j], dtype=float) for i in (0, 1) for j in (0, 1)}

    def side(a: tuple[int, int], b: tuple[int, int]) -> np.ndarray:
        return np.array([corner[a], 0.5 * (corner[a] + corner[b]) + 0.1 * rng.uniform(size=2), corner[b]])

    sides = side((0, 0), (0, 1)), side((1, 0), (1, 1)), side((0, 0), (1, 0)), side((0, 1), (1, 1))
    found = transfinite(sides, (shares,) * 4)
    for line, wanted in zip((found[0], found[-1], found[:, 0], found[:, -1]), sides, strict=True):
        assert np.array_equal(line, wanted)


def test_sides_are_blended_where_the_lines_between_opposite_shares_cross() -> None:
    bottom, top = np.array([0.0, 0.2, 1.0]), np.array([0.0, 0.6, 1.0])
    left = np.array([0.0, 0.5, 1.0])
    zero, one = np.zeros(3), np.ones(3)
    bulge = np.column_stack([0.1 * np.sin(np.pi * left), left])
    sides = bulge, np.column_stack([one, left]), np.column_stack([bottom, zero]), np.column_stack([top, one])
    found = transfinite(sides, (left, left, bottom, top))
    assert found[1, 1] == pytest.approx([0.4 + (1 - 0.4) * 0.1, 0.5])
