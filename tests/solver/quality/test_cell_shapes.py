"""Measures of the shape of cells: exact values on cells made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.quality.measures import alignment, measure, shape_regularity
from solver.quality.handmade import CONSTANT, PAPER, SLOPE, SQUARE, Analytic, constant, one_quad, uniform, wavy


@pytest.mark.parametrize("ratio", [1.0, 3.0, 0.2])
def test_rectangles(ratio: float) -> None:
    mesh = one_quad((0, 0), (ratio, 0), (ratio, 1), (0, 1))
    assert shape_regularity(mesh)[0, 0] == pytest.approx((ratio + 1 / ratio) / 2)


def test_a_rectangle_that_is_square_in_the_metric_is_aligned() -> None:
    # u = 2x, a = 1, b = 0: M = diag(5, 1), so a cell sqrt(5) times as tall as wide is a square to M.
    mesh = one_quad((0, 0), (0.2, 0), (0.2, 0.2 * math.sqrt(5)), (0, 0.2 * math.sqrt(5)))
    monitor = ArcLength(u=SLOPE, a=1.0, b=0.0, scaled=False)
    assert alignment(mesh, monitor)[0, 0] == pytest.approx(1.0)
    assert shape_regularity(mesh)[0, 0] == pytest.approx(3 / math.sqrt(5))


def test_alignment_sees_the_off_diagonal_of_the_metric() -> None:
    diagonal = Analytic(lambda x, y: x + y, constant(1.0), constant(1.0))
    monitor = ArcLength(u=diagonal, a=1.0, b=0.0, scaled=False)  # M = [[2, 1], [1, 2]], det 3
    square = one_quad((0, 0), (1, 0), (1, 1), (0, 1))
    assert alignment(square, monitor)[0, 0] == pytest.approx(4 / (2 * math.sqrt(3)))
    # F' = sheared so that F'^T M F' = diag(2, 3/2): columns (1, 0) and (-1/2, 1).
    sheared = one_quad((0, 0), (1, 0), (0.5, 1), (-0.5, 1))
    assert alignment(sheared, monitor)[0, 0] == pytest.approx(3.5 / (2 * math.sqrt(3)))


def test_a_skewed_quadrilateral_by_hand() -> None:
    # (0,0) (2,0) (2,1) (0,2): a right trapezium. Corner angles 90, 90, 90 + t, 90 - t with tan t = 1/2.
    tilt = math.atan(0.5)
    quad = one_quad((0, 0), (2, 0), (2, 1), (0, 2))
    # F' = [[2, 0], [-t, 2 - s]]: Q = (4 + t^2 + (2 - s)^2) / (4 (2 - s)), largest at s = t = 1.
    assert shape_regularity(quad)[0, 0] == pytest.approx(6 / 4)
    # The same quadrilateral tiled side by side, mirrored, so that the mesh is large enough to measure.
    columns = np.array([0.0, 2.0, 4.0, 6.0]) / 6
    low, high = np.zeros(4), np.array([2.0, 1.0, 2.0, 1.0]) / 6
    tiled = Mesh(
        np.repeat(columns[:, None], 4, axis=1),
        np.stack([low, high, high + 1 / 3, high + 2 / 3], axis=1),
    )
    q = measure(tiled, ArcLength(u=CONSTANT, scaled=False))
    row = np.s_[:, 0]
    assert q.q_geo.cells[row] == pytest.approx([1.5, 1.5, 1.5])
    assert q.scaled_jacobian.cells[row] == pytest.approx([math.cos(tilt)] * 3)
    assert q.skewness.cells[row] == pytest.approx([tilt / (math.pi / 2)] * 3)
    assert q.aspect_ratio.cells[row] == pytest.approx([math.sqrt(5)] * 3)  # edges 2, 1, sqrt 5, 2


def test_the_largest_misalignment_of_a_cell_is_at_a_corner() -> None:
    rng = np.random.default_rng(5)
    s, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21))
    m11, m12, m22 = 3.0, 1.2, 0.8
    monitor = em.Tensor(m11=em.Expression("3.0"), m12=em.Expression("1.2"), m22=em.Expression("0.8"))
    valid = 0
    for _ in range(50):
        (x0, y0), (x1, y1), (x2, y2), (x3, y3) = SQUARE + rng.uniform(-0.4, 0.4, (4, 2))
        x_s, y_s = (1 - t) * (x1 - x0) + t * (x2 - x3), (1 - t) * (y1 - y0) + t * (y2 - y3)
        x_t, y_t = (1 - s) * (x3 - x0) + s * (x2 - x1), (1 - s) * (y3 - y0) + s * (y2 - y1)
        det = x_s * y_t - x_t * y_s
        if not det.min() > 0:
            continue
        valid += 1
        trace = m11 * (x_s**2 + x_t**2) + 2 * m12 * (x_s * y_s + x_t * y_t) + m22 * (y_s**2 + y_t**2)
        got = alignment(one_quad((x0, y0), (x1, y1), (x2, y2), (x3, y3)), monitor)[0, 0]
        assert got == pytest.approx((trace / det).max() / (2 * math.sqrt(m11 * m22 - m12**2)), rel=1e-12)
    assert valid > 25, "most of the random quadrilaterals are valid cells"


@pytest.mark.parametrize("reach", [0.6, 1.8], ids=["the widest angle decides", "the narrowest angle decides"])
def test_skewness_of_a_kite(reach: float) -> None:
    mesh = uniform(4)
    x, y = mesh.x.copy(), mesh.y.copy()
    x[2, 2] = y[2, 2] = (1 + reach) / 3  # the unit kite (0,0) (1,0) (reach,reach) (0,1), a third of its size
    tip = 2 * math.degrees(math.atan2(0.5, reach - 0.5))
    angles = [90, tip, (270 - tip) / 2]
    expected = max(max(angles) - 90, 90 - min(angles)) / 90
    assert (max(angles) - 90 > 90 - min(angles)) == (reach == 0.6)
    assert measure(Mesh(x, y), ArcLength(u=CONSTANT, scaled=False)).skewness.cells[1, 1] == pytest.approx(expected)


def test_size_ratio_takes_the_worst_neighbour_along_both_directions() -> None:
    x = np.array([0.0, 0.1, 0.4, 1.0])  # widths 1, 3, 6
    y = np.array([0.0, 0.4, 0.8, 1.0])  # heights 2, 2, 1
    q = measure(Mesh(*np.meshgrid(x, y, indexing="ij")), ArcLength(u=CONSTANT, scaled=False))
    assert q.size_ratio.cells == pytest.approx(np.array([[3, 3, 3], [3, 3, 3], [2, 2, 2]], dtype=float))
    tall = measure(Mesh(*np.meshgrid(y, x, indexing="ij")), ArcLength(u=CONSTANT, scaled=False))
    assert tall.size_ratio.cells == pytest.approx(q.size_ratio.cells.T)


def test_the_measures_of_shape_do_not_see_scale_or_rotation() -> None:
    mesh, c, s = wavy(), math.cos(0.7), math.sin(0.7)
    moved = Mesh(5 + 1e-3 * (c * mesh.x - s * mesh.y), 1e-3 * (s * mesh.x + c * mesh.y))
    assert shape_regularity(moved) == pytest.approx(shape_regularity(mesh), rel=1e-9)
    first, second = (measure(m, ArcLength(u=CONSTANT, scaled=False)) for m in (mesh, moved))
    for name in ("scaled_jacobian", "skewness", "aspect_ratio", "size_ratio"):
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells, rel=1e-9), name
    assert second.min_jacobian_over_mean == pytest.approx(first.min_jacobian_over_mean)
    assert second.min_jacobian == pytest.approx(first.min_jacobian)


def test_a_collapsed_cell_is_degenerate() -> None:
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, :] = x[1, :]
    q = measure(Mesh(x, mesh.y), ArcLength(u=PAPER, scaled=False))
    assert np.isinf(q.q_ali.cells[1]).all()
    assert np.isinf(q.aspect_ratio.cells[1]).all()
    assert q.scaled_jacobian.cells[1] == pytest.approx(np.zeros(5))
    assert (q.skewness.cells[1] == 1.0).all()
