"""Curves of a description: each kind, files of points, and bad ones."""

from __future__ import annotations

from collections.abc import Callable
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
from equimesh.blocks.curves import Circle, FormulaCurve
from equimesh.blocks.spline_curve import SplineCurve

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


def test_good_entries_come_back() -> None:
    assert members({"a": 1}, "domain", ("a", "b")) == {"a": 1}
    assert entries([1, 2], "domain.corners", count=2) == [1, 2]
    assert name_among("a", "domain.corners[0]", ("a",), "vertex") == "a"
    assert (number(2, "f"), whole(7, "f", 7), point((1, 2.5), "f")) == (2.0, 7, (1.0, 2.5))


@pytest.mark.parametrize(
    ("check", "field", "message"),
    [
        (
            lambda: members({"vertex": 1}, "domain", ("vertices",)),
            "domain.vertex",
            "'vertex' that is not known",
        ),
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
