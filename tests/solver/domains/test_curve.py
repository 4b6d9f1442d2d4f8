"""Curves by formulas and through points: values and slopes, boxes, and refusals at their place."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import equimesh as em
from solver.domains.shapes import T, line, refusal


def test_formulas_in_t_with_parameters() -> None:
    curve = em.Curve.of_expressions("k*t**2", "exp(t) + where(t < 0.5, 0, 1)", {"k": 3})
    t = np.linspace(0, 1, 7)
    x, y, x_t, y_t = curve.evaluate(t)
    np.testing.assert_allclose([x, x_t], [3 * t**2, 6 * t], rtol=1e-14)
    np.testing.assert_allclose([y, y_t], [np.exp(t) + (t >= 0.5), np.exp(t)], rtol=1e-14)


def test_sampled_curves_converge_at_fourth_order() -> None:
    def error(n: int) -> float:
        k = np.linspace(0, 1, n) ** 1.2  # uneven
        curve = em.Curve.through(np.column_stack([np.cos(2 * k), np.sin(2 * k)]))
        x, y, *_ = curve.evaluate(np.linspace(0, 1, 5001))
        return float(np.abs(np.hypot(x, y) - 1).max())

    errors = np.array([error(n) for n in (17, 33, 65)])
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 3.7)
    assert errors[-1] < 1e-6


def test_two_points_give_a_straight_line_at_constant_speed() -> None:
    x, y, x_t, y_t = line(1, 2, 3, -1).evaluate(T)
    np.testing.assert_allclose([x, y], [1 + 2 * T, 2 - 3 * T], atol=1e-14)
    np.testing.assert_allclose([x_t, y_t], [np.full_like(T, 2), np.full_like(T, -3)], atol=1e-14)


def test_the_spline_passes_through_its_points() -> None:
    points = np.random.default_rng(11).random((3, 2))
    curve = em.Curve.through(points)
    chords = np.hypot(*np.diff(points, axis=0).T)
    found = curve.evaluate(np.array([0, chords[0] / chords.sum(), 1]))
    np.testing.assert_allclose(np.column_stack(found[:2]), points, atol=1e-14)


def test_the_box_is_exact() -> None:
    curve = em.Curve.of_expressions("sin(5*t)", "t*(1 - 1.3*t)")
    np.testing.assert_allclose(curve.box, [[-1, 1], [-0.3, 1 / 5.2]], rtol=1e-14)
    assert line(1, 2, 3, -1).box == ((1, 3), (-1, 2))


def test_it_goes_on_along_the_tangent_where_a_formula_ends() -> None:
    curve = em.Curve.of_expressions("t**1.5", "sin(t)")
    x, y, x_t, y_t = curve.evaluate(np.array([-1e-5, 1 + 1e-5]))
    np.testing.assert_allclose([x, x_t], [[0, (1 + 1e-5) ** 1.5], [0, 1.5 * (1 + 1e-5) ** 0.5]], atol=1e-15)
    np.testing.assert_allclose([y, y_t], [[-1e-5, math.sin(1 + 1e-5)], [1, math.cos(1 + 1e-5)]], rtol=1e-9)


@pytest.mark.parametrize(
    ("x", "y", "field", "offset", "words"),
    [
        ("x", "t", "x", 0, "'x' has no meaning here: a curve is given by formulas in t: write t"),
        ("t", "2*y", "y", 2, "write t"),
        ("t", "t%2", "y", 1, "there is no remainder"),
        ("t", "s", "y", 0, "known are t, pi, e"),
        ("", "t", "x", 0, "cos(pi*t/2)"),
        ("where(t, 1, 2)", "t", "x", 6, "t < 0.5"),
        ("t", "1 + log(t)", "y", 4, "y(t) is not finite at t = 0, because of log(t)"),
        ("sqrt(t)", "t", "x", 0, "the slope of x(t) is not finite at t = 0, because of sqrt(t)"),
        ("t", "1/(t - 1/3)", "y", 0, "the slope of y(t) grows without bound at t = 0.333333"),
        ("2e9*t", "t", "x", 0, "x(t) is larger than 1e+09"),
    ],
)
def test_formulas_are_refused_at_their_position(x: str, y: str, field: str, offset: int, words: str) -> None:
    for side in ("", "left"):
        error = refusal(em.Curve.of_expressions, x, y, side=side)
        assert isinstance(error, em.ExpressionError)
        assert error.field == (f"domain.left.{field}" if side else field)
        assert error.position.offset == offset
        assert words in error.message
        assert "unit square" not in error.message


def test_parameters_are_checked() -> None:
    for name in ("x", "y", "t", "sin"):
        error = refusal(em.Curve.of_expressions, "t", "t", {name: 1.0}, side="top")
        assert error.field == f"domain.top.parameters.{name}"


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([[0, 0]], "1 point"),
        ([[0, 0], [1, 1], [1, 1]], "points[2] repeats points[1] = (1, 1)"),
        ([[0, 0], [1, math.nan]], "points[1][1] is NaN"),
        ([[0, 0], [1, 2e9]], "points[1][1] = 2e+09"),
        ([[0, 0, 0], [1, 1, 1]], "(n, 2)"),
        ([0, 1], "a single number"),
        (np.zeros((10_001, 2)), "10001 points"),
        ([[0, 0], [0, 0]], "repeats"),
    ],
)
def test_points_are_refused(points: Any, words: str) -> None:
    error = refusal(em.Curve.through, points, side="left")
    assert error.field == "domain.left.points"
    assert words in error.message
