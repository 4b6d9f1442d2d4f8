"""Curves through nodes of the boundary: straight lines and circles where they are, else splines."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.blocks.curves import Circle
from equimesh.blocks.curves import Line as StraightLine
from equimesh.blocks.recovery.boundary import Line
from equimesh.blocks.recovery.shapes import curve_through
from equimesh.blocks.spline_curve import SplineCurve
from equimesh.numerics.types import Array

S = np.array([0.0, 0.1, 0.3, 0.35, 0.6, 0.8, 1.0])
SHAPES = {
    "straight": (np.column_stack([1 - 2 * S, 0.5 + S]), False, StraightLine),
    "arc": (np.column_stack([3 + 2 * np.cos(1 - 2 * S), np.sin(1 - 2 * S) * 2]), False, Circle),
    "large arc": (np.column_stack([np.cos(5 * S + 2), np.sin(5 * S + 2)]), False, Circle),
    "circle": (np.column_stack([np.cos(6 * S), 1 + np.sin(6 * S)]), True, Circle),
    "clockwise": (np.column_stack([np.cos(-6 * S), 1 + np.sin(-6 * S)]), True, Circle),
    "ellipse": (np.column_stack([2 * np.cos(6 * S), np.sin(6 * S)]), True, SplineCurve),
    "parabola": (np.column_stack([S, S**2]), False, SplineCurve),
    "three nodes": (np.column_stack([S, S**2])[:3], False, SplineCurve),
    "nearly straight": (np.column_stack([S, 1e-7 * np.sin(3 * S)]), False, SplineCurve),
    "a straight line turned": (np.column_stack([S, np.pi * S]) @ [[0.6, 0.8], [-0.8, 0.6]], False, StraightLine),
}


@pytest.mark.parametrize("name", SHAPES)
def test_the_curve_goes_through_the_nodes_at_their_parameters(name: str) -> None:
    points, closed, kind = SHAPES[name]
    curve, t = curve_through(points, Line(nodes=np.arange(len(points)), is_closed=closed), 1.0)
    assert isinstance(curve, kind)
    assert len(t) == len(points) + closed
    assert (np.diff(t) > 0).all() or (np.diff(t) < 0).all()
    wanted = np.concatenate([points, points[:1]]) if closed else points
    found: Array = np.column_stack(curve.evaluate(t)[:2])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
    if closed:
        low, high = curve.ends
        assert abs(t[-1] - t[0]) == pytest.approx(high - low)
