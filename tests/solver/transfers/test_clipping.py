"""The common part of two convex cells."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.transfers.overlaps import MAX_CORNERS, clip_cell, clip_half_plane, moments

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
DIAMOND = np.array([[0.5, -0.25], [1.25, 0.5], [0.5, 1.25], [-0.25, 0.5]])


def common(one: np.ndarray, other: np.ndarray) -> tuple[int, np.ndarray]:
    polygon, spare = np.zeros((2, MAX_CORNERS + 8, 2))
    count = clip_cell(one, other, polygon, spare)
    return count, polygon[:count]


def test_a_square_and_a_diamond_share_an_octagon() -> None:
    count, polygon = common(SQUARE, DIAMOND)
    area, of_x, of_y = moments(polygon, count, 0.0, 0.0)
    assert count == 8
    assert (area, of_x, of_y) == pytest.approx((1 - 4 * 0.25**2 / 2, 0.4375, 0.4375), abs=1e-14)
    assert moments(polygon, count, 0.5, 0.5)[1:] == pytest.approx((0.0, 0.0), abs=1e-15)


def test_the_order_does_not_matter_and_a_cell_inside_stays() -> None:
    inside = 0.3 + 0.2 * SQUARE
    for one, other in ((inside, SQUARE), (SQUARE, inside)):
        count, polygon = common(one, other)
        assert moments(polygon, count, 0.0, 0.0)[0] == pytest.approx(0.04, abs=1e-15)


def test_cells_apart_have_nothing_in_common() -> None:
    assert common(SQUARE, SQUARE + np.array([1.5, 0.0]))[0] == 0


def test_a_line_keeps_what_is_on_its_left() -> None:
    kept = np.zeros((8, 2))
    count = clip_half_plane(SQUARE, 4, np.array([0.25, 0.0]), np.array([0.25, 1.0]), kept)
    assert count == 4
    assert kept[:4, 0].max() == 0.25
