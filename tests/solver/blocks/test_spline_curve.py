"""Splines through points: corners, closed lines, straight pieces."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.spline_curve import SplineCurve, as_points


def around(count: int) -> tuple[tuple[float, float], ...]:
    angles = np.linspace(0, 2 * math.pi, count)
    return as_points(np.column_stack([np.cos(angles), np.sin(angles)]))


def test_a_closed_spline_has_fourth_order_and_no_corner() -> None:
    errors = []
    for count in (17, 33, 65):
        curve = SplineCurve(points=around(count), closed=True)
        assert not curve.corners.size
        x, y, *_ = curve.evaluate(np.linspace(*curve.ends, 500))
        errors.append(np.abs(np.hypot(x, y) - 1).max())
    assert min(np.log2(np.array(errors[:-1]) / errors[1:])) > 3.5
    assert errors[-1] < 1e-6


def test_corners_are_found_and_keep_their_sides_straight() -> None:
    square = SplineCurve(points=((0, 0), (1, 0), (2, 0), (2, 2), (0, 2), (0, 0)), closed=True)
    assert square.corners.tolist() == [0.0, 2.0, 4.0, 6.0]
    _, y, *_ = square.evaluate(np.linspace(0.0, 2.0, 9))
    assert np.abs(y).max() < 1e-14
    rolled = SplineCurve(points=((1, 0), (2, 0), (2, 2), (0, 2), (0, 0), (1, 0)), closed=True)
    assert [part.item() for part in rolled.evaluate(np.array(0.0))[:2]] == [2.0, 0.0]  # it begins at a corner
    assert rolled.corners.tolist() == [0.0, 2.0, 4.0, 6.0]


def test_given_corners_replace_those_that_are_found() -> None:
    points = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0))
    assert SplineCurve(points=points).corners.tolist() == [1.0]
    smooth = SplineCurve(points=points, corners_at=())
    assert smooth.corners.tolist() == []
    assert [part.item() for part in smooth.evaluate(np.array(1.0))[:2]] == pytest.approx([1.0, 0.0])


def test_a_line_of_straight_pieces() -> None:
    curve = SplineCurve(points=((0.0, 0.0), (1.0, 1.0), (2.0, 0.0)), straight=True)
    x, y, *_ = curve.evaluate(np.linspace(*curve.ends, 5))
    assert y == pytest.approx(1 - np.abs(1 - x))
    assert curve.corners == pytest.approx([math.sqrt(2)])


@pytest.mark.parametrize(
    ("points", "extra", "message"),
    [
        (((0, 0),), {}, "1 points: 2 at least"),
        (((0, 0), (1, 0), (1, 0)), {}, r"points\[2\] repeats points\[1\] = \(1, 0\)"),
        (((0, 0), (1, 0), (1, 1), (0, 1)), {"closed": True}, r"ends at \(0, 1\), 1 apart: repeat the first point"),
        (((0, 0), (1, 0), (0, 0)), {"closed": True}, "closed curve needs 4"),
        (((0, 0), (1, 0), (1, 1)), {"corners_at": (3,)}, "corners has 3"),
    ],
)
def test_points_without_a_curve_are_refused(points: tuple, extra: dict, message: str) -> None:
    with pytest.raises(em.InputError, match=message) as caught:
        SplineCurve(points=points, where="domain.curves.wall.points", **extra)
    assert caught.value.field == "domain.curves.wall.points"
