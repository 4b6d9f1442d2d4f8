"""Quadrilaterals between four curves: the map, and precise refusals of sides that do not fit."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from solver.domains.shapes import S, T, line, refusal, wavy


def test_the_sides_go_where_the_curves_go() -> None:
    domain, k = wavy(), np.linspace(0, 1, 33)
    for name, (s, t) in {
        "bottom": (k, 0 * k),
        "top": (k, 0 * k + 1),
        "left": (0 * k, k),
        "right": (0 * k + 1, k),
    }.items():
        np.testing.assert_allclose(domain.map(s, t), getattr(domain, name).evaluate(k)[:2], atol=1e-15)


def test_straight_sides_give_the_bilinear_map() -> None:
    p = np.array([[0, 0], [2, -0.5], [2.5, 2], [0.3, 1]])
    domain = em.Quadrilateral(
        bottom=line(*p[0], *p[1]), right=line(*p[1], *p[2]), top=line(*p[3], *p[2]), left=line(*p[0], *p[3])
    )
    x, y = domain.map(S, T)
    shapes = [(1 - S) * (1 - T), S * (1 - T), S * T, (1 - S) * T]
    np.testing.assert_allclose(x, sum(w * q[0] for w, q in zip(shapes, p, strict=True)), atol=1e-14)
    np.testing.assert_allclose(y, sum(w * q[1] for w, q in zip(shapes, p, strict=True)), atol=1e-14)


def test_a_sector_given_by_formulas_is_the_sector() -> None:
    arc = ("{0}*cos(pi*t/2)", "{0}*sin(pi*t/2)")
    domain = em.Quadrilateral(
        bottom=line(1, 0, 2, 0),
        top=line(0, 1, 0, 2),
        left=em.Curve.of_expressions(*(text.format(1) for text in arc)),
        right=em.Curve.of_expressions(*(text.format(2) for text in arc)),
    )
    sector = em.AnnulusSector()
    np.testing.assert_allclose(domain.map(S, T), sector.map(S, T), atol=1e-14)
    np.testing.assert_allclose(domain.jacobian(S, T), sector.jacobian(S, T), atol=1e-14)
    assert domain.area == pytest.approx(sector.area, rel=1e-12)
    np.testing.assert_allclose(domain.box, sector.box, atol=1e-14)


def test_area() -> None:
    bumps = em.Curve.of_expressions("1", "t")
    exact = 1 - 0.4 / np.pi + 0.2 / np.pi  # a side x = -0.1 sin(pi y) adds 0.2 / pi
    assert wavy(right=bumps).area == pytest.approx(exact, rel=1e-6)  # the left side is a spline


def test_corners_that_do_not_meet_are_named() -> None:
    error = refusal(wavy, bottom=em.Curve.of_expressions("t", "0.3*t"))
    assert error.field == "domain.right"
    assert "bottom ends at (1, 0.3), but right starts at (1, 0)" in error.message
    error = refusal(wavy, top=em.Curve.of_expressions("1 - t", "1"))
    assert "top ends at (0, 1), but right ends at (1, 1)" in error.message
    error = refusal(wavy, top=em.Curve.of_expressions("t - 0.01*(1 - t)", "1"))
    assert error.field == "domain.left"
    assert "top starts at (-0.01, 1), but left ends at (" in error.message


def test_a_folding_patch_is_refused_with_the_place() -> None:
    error = refusal(wavy, bottom=em.Curve.of_expressions("t", "0.9*sin(pi*t)"), right=line(1, 0, 1, 1))
    assert error.field == "domain"
    assert "the map folds at (x, y) = (0.6" in error.message
    assert "on bottom at t = 0.6" in error.message
    x, y = (float(part) for part in error.message.split("= (")[1].split(")")[0].split(","))
    assert y == pytest.approx(0.9 * math.sin(math.pi * x), abs=1e-5)


def test_a_map_that_is_flat_is_refused() -> None:
    error = refusal(wavy, left=em.Curve.of_expressions("0", "t**2"))
    assert "the map is flat at (x, y) = (0, 0), the corner of bottom and left" in error.message
    quarter = {
        name: em.Curve.of_expressions(f"cos(pi*({a} + {b}*t))", f"sin(pi*({a} + {b}*t))")
        for name, a, b in (("bottom", 1.25, 0.5), ("right", -0.25, 0.5), ("top", 0.75, -0.5), ("left", 1.25, -0.5))
    }
    assert "180 degrees" in refusal(em.Quadrilateral, **quarter).message  # a disk has no corners


def test_a_mirrored_patch_is_refused() -> None:
    error = refusal(
        em.Quadrilateral, bottom=line(0, 0, 0, 1), left=line(0, 0, 1, 0), top=line(1, 0, 1, 1), right=line(0, 1, 1, 1)
    )
    assert "clockwise" in error.message
    assert "exchange bottom with left" in error.message


def test_a_patch_that_covers_itself_is_refused_though_its_jacobian_is_positive() -> None:
    angle = "2.2*pi*t"
    error = refusal(
        em.Quadrilateral,
        left=em.Curve.of_expressions(f"cos({angle})", f"sin({angle})"),
        right=em.Curve.of_expressions(f"2*cos({angle})", f"2*sin({angle})"),
        bottom=line(1, 0, 2, 0),
        top=line(math.cos(2.2 * math.pi), math.sin(2.2 * math.pi), *(2 * f(2.2 * math.pi) for f in TURN)),
    )
    assert "cross" in error.message


def test_a_ring_cut_open_is_accepted() -> None:
    domain = em.Quadrilateral(
        left=em.Curve.of_expressions("cos(2*pi*t)", "sin(2*pi*t)"),
        right=em.Curve.of_expressions("2*cos(2*pi*t)", "2*sin(2*pi*t)"),
        bottom=line(1, 0, 2, 0),
        top=line(1, 0, 2, 0),
    )
    assert domain.area == pytest.approx(3 * math.pi, rel=1e-12)


def test_sides_must_be_curves() -> None:
    assert refusal(wavy, left=[[0, 0], [0, 1]]).field == "domain.left"


TURN = (math.cos, math.sin)
