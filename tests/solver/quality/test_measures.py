"""Quality measures: the paper's number, exact values, invariants, and folded meshes."""

from __future__ import annotations

import json
import math
import tracemalloc
import warnings

import numpy as np
import pytest

import equimesh as em
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.arc_length import ArcLength
from equimesh.quality import measures
from equimesh.quality.measures import equidistribution, measure
from solver.quality.handmade import CONSTANT, CUBIC_Y, ERRORS, PAPER, TANH20, Analytic, folded, uniform, wavy


def test_uniform_mesh_has_the_q_eq_of_table_1() -> None:
    q = equidistribution(uniform(12), ArcLength(u=PAPER, a=0.7, b=0.05, scaled=False))
    assert q.shape == (11, 11)
    assert f"{q.max():.4f}" == "1.6375"


def test_eight_gauss_points_are_enough_for_the_paper() -> None:
    monitor = ArcLength(u=PAPER, scaled=False)
    fine = equidistribution(uniform(12), monitor, gauss=20)
    assert np.abs(equidistribution(uniform(12), monitor) - fine).max() < 1e-9
    assert np.abs(equidistribution(uniform(12), monitor, gauss=4) - fine).max() > 1e-9


def test_the_largest_q_eq_sits_where_the_layer_is() -> None:
    q = equidistribution(uniform(12), ArcLength(u=PAPER, scaled=False))
    i, j = np.unravel_index(q.argmax(), q.shape)
    assert i == 10
    assert j == 5


def test_nothing_to_adapt_to_makes_every_measure_perfect() -> None:
    q = measure(uniform(7), ArcLength(u=CONSTANT, scaled=False))
    for name in ("q_eq", "q_ali", "q_geo", "scaled_jacobian", "aspect_ratio", "size_ratio"):
        assert getattr(q, name).cells == pytest.approx(np.ones((6, 6)), abs=1e-12), name
    assert q.skewness.max == pytest.approx(0.0, abs=1e-12)
    assert q.min_jacobian == pytest.approx(1.0)
    assert q.min_jacobian_over_mean == pytest.approx(1.0)
    error = q.interpolation_error
    assert max(error.l2, error.l2_uniform, error.h1, error.h1_uniform) < 1e-13


def test_mean_metric_is_the_integral_over_the_cell_and_not_its_centre_value() -> None:
    # b = 0, u = y^3: det M = 1 + 9 a^2 y^4, and det M_K = 1 + 9 a^2 (the mean of y^4 over the cell).
    mesh = Mesh(*np.meshgrid([0.0, 1.0], [0.0, 0.5, 1.0], indexing="ij"))
    means = np.array([0.5**5, 1 - 0.5**5]) / 5 / 0.5
    share = np.sqrt(1 + 9 * 0.25 * means)
    expected = 2 * share / share.sum()
    assert equidistribution(mesh, ArcLength(u=CUBIC_Y, a=0.5, b=0.0, scaled=False))[0] == pytest.approx(
        expected, rel=1e-12
    )


def test_mean_metric_weighs_by_area_in_a_tapered_cell() -> None:
    # Trapezium of width 1 at y = 0 and 0.5 at y = 1 beside its complement in a rectangle of height 1:
    # the mean of 9 y^4 over a width w(y) is 9 int y^4 w / int w.
    mesh = Mesh(np.array([[0.0, 0.0], [1.0, 0.5], [2.0, 2.0]]), np.array([[0.0, 1.0]] * 3))
    area = np.array([0.75, 1.25])
    moment = np.array([1 / 5 - 0.5 / 6, 1 / 5 + 0.5 / 6])  # int y^4 (1 -+ y/2)
    share = area * np.sqrt(1 + 9 * moment / area)
    expected = 2 * share / share.sum()
    got = equidistribution(mesh, ArcLength(u=CUBIC_Y, a=1.0, b=0.0, scaled=False))[:, 0]
    assert got == pytest.approx(expected, rel=1e-12)


def test_q_eq_averages_to_one_and_the_others_are_at_least_one() -> None:
    q = measure(wavy(), ArcLength(u=PAPER, scaled=False))
    assert q.q_eq.mean == pytest.approx(1.0, abs=1e-14)
    assert q.q_eq.min > 0
    assert q.q_eq.rms > 1.0
    for name in ("q_ali", "q_geo", "aspect_ratio", "size_ratio"):
        assert getattr(q, name).min >= 1.0 - 1e-12, name
        assert getattr(q, name).cells.shape == (12, 8), name
    assert 0 < q.scaled_jacobian.min <= q.scaled_jacobian.max <= 1
    assert 0 <= q.skewness.min <= q.skewness.max < 1


def test_reflection_reflects_every_measure() -> None:
    mesh = wavy()
    mirrored = Mesh(mesh.x[:, ::-1], 1 - mesh.y[:, ::-1])
    first, second = (measure(m, ArcLength(u=PAPER, scaled=False)) for m in (mesh, mirrored))
    for name in measures.PER_CELL:
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells[:, ::-1]), name
    assert second.interpolation_error.l2 == pytest.approx(first.interpolation_error.l2)
    assert second.interpolation_error.h1 == pytest.approx(first.interpolation_error.h1)


def test_exchanging_the_axes_transposes_every_measure() -> None:
    mesh, u = wavy(), PAPER
    turned = Analytic(lambda x, y: u.value(y, x), lambda x, y: u.along_y(y, x), lambda x, y: u.along_x(y, x))
    first, second = (
        measure(mesh, ArcLength(u=u, scaled=False)),
        measure(Mesh(mesh.y.T, mesh.x.T), ArcLength(u=turned, scaled=False)),
    )
    for name in measures.PER_CELL:
        assert getattr(second, name).cells == pytest.approx(getattr(first, name).cells.T), name


def test_the_temporaries_of_a_large_mesh_are_small() -> None:
    mesh, monitor = uniform(513), ArcLength(u=TANH20, scaled=False)
    measure(uniform(320), monitor)  # what is kept for good
    tracemalloc.start()
    try:
        kept = measure(mesh, monitor)
        now, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    cells = mesh.grid.cells
    assert kept.q_eq.cells.size == cells
    assert now < 58 * cells
    assert peak - now < 60 * cells + 4e6


def test_a_monitor_without_u_has_no_interpolation_error() -> None:
    q = measure(wavy(), em.Weight(rho=em.Expression("1 + x")))
    assert q.interpolation_error is None
    assert q.summary()["interpolation_error"] is None
    assert q.q_eq.mean == pytest.approx(1.0)


def test_every_monitor_is_measured_by_its_own_metric() -> None:
    # rho = 1 + x on the unit square: the mean of rho over a column is that at its centre, the shares are known.
    q = equidistribution(uniform(5), em.Weight(rho=em.Expression("1 + x")))
    expected = (1 + np.array([1, 3, 5, 7]) / 8) / 1.5
    assert q == pytest.approx(np.repeat(expected[:, None], 4, axis=1), rel=1e-12)


def test_a_folded_mesh_is_infinite_where_it_folds_and_raises_no_warning() -> None:
    mesh = folded()
    assert mesh.is_folded
    bad = (mesh.corner_jacobians() <= 0).any(axis=0)
    assert 0 < bad.sum() < bad.size
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        q = measure(mesh, ArcLength(u=PAPER, scaled=False))
        summary = q.summary(arrays=True)
    for name in ("q_eq", "q_ali", "q_geo"):
        cells = getattr(q, name).cells
        assert np.array_equal(np.isinf(cells), bad), name
        assert np.isfinite(cells[~bad]).all(), name
        assert getattr(q, name).max == math.inf, name
    assert q.size_ratio.max == math.inf
    assert q.scaled_jacobian.min <= 0
    assert np.array_equal(q.skewness.cells == 1.0, bad)
    assert q.min_jacobian <= 0
    assert math.isinf(q.interpolation_error.l2)
    assert math.isfinite(q.interpolation_error.l2_uniform)
    assert summary["q_ali"]["max"] is None
    json.dumps(summary, allow_nan=False)


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_coordinates_that_are_not_finite_count_as_folded(value: float) -> None:
    mesh = uniform(6)
    x = mesh.x.copy()
    x[2, 3] = value
    q = measure(Mesh(x, mesh.y), ArcLength(u=PAPER, scaled=False))
    assert np.isinf(q.q_eq.cells[1:3, 2:4]).all()
    assert np.isinf(q.q_ali.cells[1:3, 2:4]).all()
    json.dumps(q.summary(arrays=True), allow_nan=False)


def test_summary_is_plain_json() -> None:
    q = measure(wavy(5, 4), ArcLength(u=PAPER, scaled=False))
    plain = q.summary()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert set(plain["q_eq"]) == {"max", "min", "mean", "rms"}
    assert plain["q_eq"]["max"] == q.q_eq.cells.max()
    assert set(plain["interpolation_error"]) == {*ERRORS, "gain_l2", "gain_h1"}
    full = q.summary(arrays=True)
    assert np.array_equal(np.array(full["q_geo"]["cells"]), q.q_geo.cells)
    assert {type(value) for row in full["q_eq"]["cells"] for value in row} == {float}
