"""Straight lines, circles, formulas: places, velocities, nearest points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import Airfoil
from equimesh.blocks.curves import BoundaryCurve, Chords, Circle, FormulaCurve, Line, parameters_at, span, wrapped
from equimesh.blocks.spline_curve import SplineCurve

ANGLES = np.linspace(0, 2 * math.pi, 25)
CURVES = [
    Line(start=(1.0, 2.0), end=(4.0, 6.0)),
    Circle(center=(1.0, -1.0), radius=2.0),
    FormulaCurve(curve=em.Curve.of_expressions("t", "t**2 - t")),
    SplineCurve(points=((0.0, 0.0), (1.0, 0.5), (2.0, 0.0), (3.0, 1.0))),
    SplineCurve(points=tuple((math.cos(a), 2 * math.sin(a)) for a in ANGLES), closed=True),
    Airfoil(digits="0012"),
    Airfoil(digits="4415", chord=2.0, leading_edge=(1.0, 1.0), angle=5.0),
]


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: type(curve).__name__)
def test_velocities_are_the_derivatives_of_places(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.013, 0.987, 23)
    step = 1e-6 * (high - low)
    x, y, x_t, y_t = curve.evaluate(t)
    ahead, behind = curve.evaluate(t + step), curve.evaluate(t - step)
    size = np.hypot(x_t, y_t).max()
    assert np.abs((ahead[0] - behind[0]) / (2 * step) - x_t).max() < 1e-6 * size
    assert np.abs((ahead[1] - behind[1]) / (2 * step) - y_t).max() < 1e-6 * size
    assert x.shape == y.shape == t.shape


@pytest.mark.parametrize("curve", CURVES, ids=lambda curve: type(curve).__name__)
def test_points_of_the_curve_are_their_own_nearest_ones(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.02, 0.98, 15)
    x, y, x_t, y_t = curve.evaluate(t)
    assert np.abs(curve.nearest(x, y) - t).max() < 1e-9 * (high - low)
    off = 1e-3 / np.hypot(x_t, y_t)
    assert np.abs(curve.nearest(x - off * y_t, y + off * x_t) - t).max() < 1e-6 * (high - low)


@pytest.mark.parametrize("curve", [c for c in CURVES if c.closed], ids=lambda curve: type(curve).__name__)
def test_closed_curves_repeat(curve: BoundaryCurve) -> None:
    low, high = curve.ends
    t = low + (high - low) * np.linspace(0.1, 0.9, 7)
    for turns in (-2, 1):
        again = t + turns * (high - low)
        assert np.abs(wrapped(curve, again) - t).max() < 1e-12
        assert curve.evaluate(again)[0] == pytest.approx(curve.evaluate(t)[0], abs=1e-12)
    assert [part.item() for part in curve.evaluate(np.array(low))[:2]] == pytest.approx(
        [part.item() for part in curve.evaluate(np.array(high))[:2]], abs=1e-12
    )


def test_nearest_points_of_a_line_stay_between_its_ends() -> None:
    line = Line(start=(0.0, 0.0), end=(2.0, 0.0))
    assert line.nearest(np.array([-1.0, 0.5, 3.0]), np.array([1.0, 1.0, 1.0])).tolist() == [0.0, 0.5, 2.0]


def test_an_open_formula_named_closed_is_refused() -> None:
    round_trip = FormulaCurve(curve=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"), closed=True)
    assert round_trip.corners.tolist() == []
    drop = FormulaCurve(curve=em.Curve.of_expressions("sin(pi*t)", "sin(2*pi*t)"), closed=True)
    assert drop.corners.tolist() == [0.0]
    with pytest.raises(em.InputError, match=r"named closed, but begins at \(0, 0\) and ends at \(1, 0\), 1 apart"):
        FormulaCurve(curve=em.Curve.of_expressions("t", "t**2 - t"), closed=True)


# Parts of curves: the way of an edge, and its nodes by length.


NAMES = {"name": "a-b", "field": "domain.edges[0].on"}


def test_the_shorter_way_is_taken_unless_a_point_is_named() -> None:
    circle = Circle(radius=2.0)
    assert span(circle, 3.0, -3.0, via=None, **NAMES) == pytest.approx([3.0, 2 * math.pi - 3.0])
    assert span(circle, -3.0, 3.0, via=None, **NAMES) == pytest.approx([-3.0, 3.0 - 2 * math.pi])
    assert span(circle, -3.0, 3.0, via=(2.0, 0.0), **NAMES) == pytest.approx([-3.0, 3.0])
    assert span(circle, 1.0, 1.0, via=None, **NAMES) == pytest.approx([1.0, 1.0 + 2 * math.pi])
    assert span(Line(start=(0.0, 0.0), end=(1.0, 0.0)), 0.7, 0.2, via=None, **NAMES).tolist() == [0.7, 0.2]


def test_two_ways_of_one_length_need_a_point() -> None:
    with pytest.raises(em.InputError, match=r'edge a-b can take two ways .* "via", such as \[.*\]') as caught:
        span(Airfoil(digits="0012"), 0.0, 1.0, via=None, **NAMES)
    assert caught.value.field == "domain.edges[0].on"
    assert span(Airfoil(digits="0012"), 0.0, 1.0, via=(0.5, -0.1), **NAMES).tolist() == [0.0, -1.0]


@pytest.mark.parametrize("ends", [(0.1, 0.95), (0.95, 0.1)])
def test_nodes_stand_at_shares_of_the_length(ends: tuple[float, float]) -> None:
    foil = Airfoil(digits="0012")
    shares = np.linspace(0.0, 1.0, 6)
    t = parameters_at(foil, np.array(ends), shares)
    assert (t[0], t[-1]) == ends
    lengths = []
    for first, last in pairwise(t):
        x, y, *_ = foil.evaluate(np.linspace(first, last, 20_001))
        lengths.append(np.hypot(np.diff(x), np.diff(y)).sum())
    assert lengths == pytest.approx([np.mean(lengths)] * 5, rel=1e-7)


def test_nodes_of_a_circle_are_exact() -> None:
    t = parameters_at(Circle(), np.array([0.0, 1.0]), np.array([0.0, 0.25, 1.0]))
    assert t.tolist() == [0.0, 0.25, 1.0]


# Edges between points of a curve, and the area between them and the curve.


COUNT = 24
CHORD_ANGLES = np.linspace(-math.pi, math.pi, COUNT, endpoint=False)
RING = np.stack([np.arange(COUNT), np.roll(np.arange(COUNT), -1)], axis=1)
POINTS = np.stack([np.cos(CHORD_ANGLES), np.sin(CHORD_ANGLES)])
STEP = 2.0 * math.pi / COUNT


def chords(slides: np.ndarray, edges: np.ndarray = RING) -> Chords | None:
    return Chords.of(Circle(), edges, slides, POINTS, np.where(slides, CHORD_ANGLES, 0.0))


@pytest.mark.parametrize("fixed", [[], [0], [5, 6, 11]])
def test_the_circle_is_closed_and_fixed_nodes_are_ends_of_its_pieces(fixed: list[int]) -> None:
    slides = ~np.isin(np.arange(COUNT), fixed)
    found = chords(slides)
    assert found is not None
    pieces = COUNT - (5 in fixed)  # an edge between two fixed nodes does not change
    assert len(found.nodes) == pieces
    assert found.cut_off(CHORD_ANGLES) == pytest.approx(0.5 * pieces * (STEP - math.sin(STEP)), rel=3e-3)


def test_longer_edges_cut_off_more_also_beyond_the_begin_of_the_circle() -> None:
    found = chords(np.ones(COUNT, dtype=bool))
    assert found is not None
    moved = CHORD_ANGLES + 0.9 * np.sin(CHORD_ANGLES) + 2.0
    lengths = np.diff(np.append(moved, moved[0] + 2.0 * math.pi))
    assert found.cut_off(moved) == pytest.approx(0.5 * float((lengths - np.sin(lengths)).sum()), rel=1e-2)


def test_lines_and_nodes_elsewhere_have_none() -> None:
    everywhere = np.ones(COUNT, dtype=bool)
    assert Chords.of(Line(start=(0.0, 0.0), end=(1.0, 0.0)), RING, everywhere, POINTS, CHORD_ANGLES) is None
    assert chords(~everywhere) is None
    slides = everywhere.copy()
    slides[3] = False
    away = POINTS.copy()
    away[:, 3] *= 0.5
    found = Chords.of(Circle(), RING, slides, away, CHORD_ANGLES)
    assert found is not None
    assert len(found.nodes) == COUNT - 2


def test_the_nearest_point_of_a_closed_curve_may_lie_just_before_its_end() -> None:
    ring = FormulaCurve(curve=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"), closed=True)
    t = np.array([0.9996, 0.9999, 0.0001, 0.0004])
    x, y, *_ = ring.evaluate(t)
    np.testing.assert_allclose(ring.nearest(x, y), t, atol=1e-9)
