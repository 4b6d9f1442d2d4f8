"""Curves: places, velocities, nearest points, splines through points, and the entries of a description."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import (
    Airfoil,
    curve_of,
    entries,
    mapping,
    members,
    name_among,
    number,
    point,
    read_points,
    whole,
    with_points,
)
from equimesh.blocks.curves import BoundaryCurve, Chords, Circle, FormulaCurve, Line, parameters_at, span, wrapped
from equimesh.blocks.spline_curve import SplineCurve, as_points

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
    pieces = COUNT - (5 in fixed)  # an edge between two fixed nodes does not change
    assert len(found.nodes) == pieces
    assert found.pieces(CHORD_ANGLES).area == pytest.approx(0.5 * pieces * (STEP - math.sin(STEP)), rel=3e-3)


def test_longer_edges_cut_off_more_also_beyond_the_begin_of_the_circle() -> None:
    found = chords(np.ones(COUNT, dtype=bool))
    moved = CHORD_ANGLES + 0.9 * np.sin(CHORD_ANGLES) + 2.0
    lengths = np.diff(np.append(moved, moved[0] + 2.0 * math.pi))
    assert found.pieces(moved).area == pytest.approx(0.5 * float((lengths - np.sin(lengths)).sum()), rel=1e-2)
    slopes, bends = found.pieces(moved).derivatives(COUNT)
    steps = 1e-4 * np.eye(COUNT)
    before, here, after = (np.array([found.pieces(moved + k * step).area for step in steps]) for k in (-1, 0, 1))
    assert slopes == pytest.approx((after - before) / 2e-4, rel=1e-5, abs=1e-9)
    assert bends == pytest.approx((after - 2.0 * here + before) / 1e-8, rel=0.1, abs=1e-3)


def test_lines_and_nodes_elsewhere_have_none() -> None:
    everywhere = np.ones(COUNT, dtype=bool)
    assert Chords.of(Line(start=(0.0, 0.0), end=(1.0, 0.0)), RING, everywhere, POINTS, CHORD_ANGLES) is None
    assert chords(~everywhere) is None
    slides = everywhere.copy()
    slides[3] = False
    away = POINTS.copy()
    away[:, 3] *= 0.5
    found = Chords.of(Circle(), RING, slides, away, CHORD_ANGLES)
    assert len(found.nodes) == COUNT - 2


def test_the_nearest_point_of_a_closed_curve_may_lie_just_before_its_end() -> None:
    ring = FormulaCurve(curve=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"), closed=True)
    t = np.array([0.9996, 0.9999, 0.0001, 0.0004])
    x, y, *_ = ring.evaluate(t)
    np.testing.assert_allclose(ring.nearest(x, y), t, atol=1e-9)


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


FIELD = "domain.curves.wall"


def test_each_kind_is_read() -> None:
    assert curve_of({"circle": {"center": [1, 2], "radius": 3}}, FIELD) == Circle(center=(1.0, 2.0), radius=3.0)
    foil = curve_of({"naca": "2412", "chord": 2, "leading_edge": [1, 0], "angle": 4}, FIELD)
    assert isinstance(foil, Airfoil)
    assert (foil.digits, foil.chord, foil.leading_edge, foil.angle) == ("2412", 2.0, (1.0, 0.0), 4.0)
    formula = curve_of({"x": "t", "y": "a*t**2", "parameters": {"a": 2}}, FIELD)
    assert isinstance(formula, FormulaCurve)
    assert formula.evaluate(np.array([0.5]))[1] == pytest.approx([0.5])
    spline = curve_of({"points": [[0, 0], [1, 1], [2, 0], [1, -1], [0, 0]], "corners": []}, FIELD)
    assert isinstance(spline, SplineCurve)
    assert (spline.closed, spline.corners.size) == (True, 0)
    straight = curve_of({"polyline": [[0, 0], [1, 1], [2, 0]]}, FIELD)
    assert isinstance(straight, SplineCurve)
    assert (straight.straight, straight.closed) == (True, False)


def test_points_come_from_a_file_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "foil.csv").write_text("NACA 0012\n\n1.0, 0.0\n0.5 0.06  # upper\n0;0\n")
    assert read_points("foil.csv", tmp_path, FIELD) == [(1.0, 0.0), (0.5, 0.06), (0.0, 0.0)]
    found = with_points({"wall": {"points": "foil.csv"}, "other": {"naca": "0012"}}, tmp_path)
    assert found == {"wall": {"points": [[1.0, 0.0], [0.5, 0.06], [0.0, 0.0]]}, "other": {"naca": "0012"}}


@pytest.mark.parametrize(
    ("text", "message"),
    [("1 2\n3 4\nx y\n", "foil.csv, line 3: 'x y' is no pair"), ("only words\n", "has no line with two numbers")],
)
def test_files_without_points_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "foil.csv").write_text(text)
    with pytest.raises(em.InputError, match=message):
        read_points("foil.csv", tmp_path, FIELD)


def test_a_file_needs_a_folder_and_has_to_be_there(tmp_path: Path) -> None:
    with pytest.raises(
        em.InputError, match=r"foil.csv is the name of a file: write the points as a list, or in Python give folder="
    ):
        read_points("foil.csv", None, FIELD)
    with pytest.raises(em.InputError, match=r"^foil.csv cannot be read: No such file or directory$"):
        read_points("foil.csv", tmp_path, FIELD)


@pytest.mark.parametrize(
    ("entry", "field", "message"),
    [
        ({}, "", "must have one of the members circle"),
        ({"circle": {}, "naca": "0012"}, "", "one of the members"),
        ({"circle": {"radius": 0}}, ".circle.radius", "positive"),
        ({"circle": {}, "closed": True}, ".closed", "not known"),
        ({"naca": 12}, ".naca", "text of four digits"),
        ({"x": "t"}, ".y", "must be a formula in t"),
        ({"x": "t", "y": "sqrt(t - 2)"}, ".y", "not finite"),
        ({"points": [[0, 0]]}, ".points", "has 1 points"),
        ({"points": [[0, 0], [1, None]]}, ".points[1][1]", "null"),
        ({"points": [[0, 0], [1, 0]], "closed": 1}, ".closed", "true or false"),
        ({"points": [[0, 0], [1, 0], [1, 1], [0, 1]], "closed": True}, ".points", "named closed"),
        ({"points": [[0, 0], [1, 0], [2, 1]], "corners": ["1"]}, ".corners", "whole numbers"),
        ({"polyline": [[0, 0], [2, 2], [2, 0], [0, 2]]}, ".polyline", "crosses itself near (0.9"),
    ],
)
def test_bad_curves_are_refused_with_their_path(entry: dict, field: str, message: str) -> None:
    with pytest.raises(em.InputError) as caught:
        curve_of(entry, FIELD)
    assert caught.value.field == FIELD + field
    assert message in caught.value.message


# Entries of a description: objects, lists, names and numbers, with the path of a bad one.


@pytest.mark.parametrize(
    ("check", "field", "message"),
    [
        (lambda: members({"vertex": 1}, "domain", ("vertices",)), "domain.vertex", "'vertex' that is not known"),
        (lambda: mapping([1], "domain.curves"), "domain.curves", "curves is a list: it must be an object"),
        (lambda: mapping({1: 2}, "domain.curves"), "domain.curves", "must be an object"),
        (lambda: entries("ab", "domain.blocks"), "domain.blocks", "blocks is the text 'ab': it must be a list"),
        (lambda: entries([1], "domain.corners", count=4), "domain.corners", "has 1 entries: it must have 4"),
        (lambda: name_among("z", "f", ("a", "b"), "vertex"), "f", "'z' is no vertex: there are a, b"),
        (lambda: name_among([], "f", (), "curve"), "f", "there are none"),
        (lambda: number(float("nan"), "f"), "f", "f is nan"),
        (lambda: number(True, "f"), "f", "a boolean"),
        (lambda: number(0, "f", positive=True), "f", "f is 0: it must be a positive number"),
        (lambda: whole(2.0, "f", 5), "f", "f is 2.0: it must be a whole number from 1 to 5"),
        (lambda: point([1, "x"], "f"), "f[1]", "the text 'x'"),
    ],
)
def test_bad_entries_are_refused_with_their_path(check: Callable[[], object], field: str, message: str) -> None:
    with pytest.raises(em.InputError) as caught:
        check()
    assert caught.value.field == field
    assert message in caught.value.message


# Profiles of airfoils: thickness, camber, edges.


def test_a_symmetric_profile_has_its_thickness_and_closed_edges() -> None:
    foil = Airfoil(digits="0012")
    x, y, *_ = foil.evaluate(np.linspace(0.0, 2.0, 4001))
    assert np.ptp(y) == pytest.approx(0.12, rel=1e-3)
    assert x[y.argmax()] == pytest.approx(0.3, abs=5e-3)
    assert y == pytest.approx(-y[::-1], abs=1e-15)
    assert abs(y[0]) < 1e-15
    assert (x.min(), x.max()) == (0.0, 1.0)
    # Published ordinates in per cent of the chord, at 5, 30 and 60 per cent of it.
    shares = 1.0 - np.sqrt([0.05, 0.30, 0.60])
    assert 100 * foil.evaluate(shares)[1] == pytest.approx([3.555, 6.002, 4.563], abs=0.02)


def test_camber_lifts_the_profile_and_the_angle_turns_it_clockwise() -> None:
    x, y, *_ = Airfoil(digits="2412").evaluate(np.linspace(0.0, 2.0, 4001))
    upper, lower = np.interp(0.4, x[2000::-1], y[2000::-1]), np.interp(0.4, x[2000:], y[2000:])
    assert 0.5 * (upper + lower) == pytest.approx(0.02, abs=1e-4)
    turned = Airfoil(digits="0012", chord=2.0, leading_edge=(1.0, 1.0), angle=30.0)
    at = [part.item() for part in turned.evaluate(np.array(0.0))[:2]]
    assert at == pytest.approx([1 + 2 * np.cos(np.pi / 6), 0.0])


@pytest.mark.parametrize("digits", ["12", "00122", "00a2", "0000", "2012", "0412", "٠٠١٢"])
def test_other_digits_are_refused(digits: str) -> None:
    with pytest.raises(em.InputError, match="naca = ") as caught:
        Airfoil(digits=digits, where="domain.curves.foil.naca")
    assert caught.value.field == "domain.curves.foil.naca"
