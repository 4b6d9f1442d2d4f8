"""Curves of a description: each kind, files of points, and bad ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import equimesh as em
from equimesh.blocks.curve_entries import Airfoil, curve_of, read_points, with_points
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
