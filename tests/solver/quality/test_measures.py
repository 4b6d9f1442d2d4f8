"""Quality measures: the paper's number, exact values, invariants, and folded meshes."""

from __future__ import annotations

import json
import math
import tracemalloc
import warnings

import numpy as np
import pytest

import equimesh as em
from block_cases import changed, channel, in_blocks, l_shape
from equimesh.errors import InputError
from equimesh.meshes.mesh import Mesh
from equimesh.monitors.metrics import ArcLength
from equimesh.quality import measures
from equimesh.quality.cells import BilinearCells, QuadCells, cells_of
from equimesh.quality.interpolation import MIN_SAMPLED_CELLS, probe_errors, sample
from equimesh.quality.measures import (
    PER_CELL,
    alignment,
    equidistribution,
    measure,
    measure_all,
    measure_each,
    measure_errors,
    shape_regularity,
)
from equimesh.quality.shapes import Shapes
from equimesh.quality.tally import ErrorRule, ErrorTally
from solver.quality.handmade import (
    CONSTANT,
    CUBIC_Y,
    ERRORS,
    PAPER,
    SLOPE,
    SQUARE,
    TANH20,
    Analytic,
    constant,
    folded,
    one_quad,
    triangle_errors,
    uniform,
    wavy,
)


def test_uniform_mesh_has_the_q_eq_of_table_1() -> None:
    q = equidistribution(uniform(12), ArcLength(u=PAPER, a=0.7, b=0.05, scaled=False))
    assert q.shape == (11, 11)
    assert f"{q.max():.4f}" == "1.6375"


def test_eight_gauss_points_are_enough_for_the_paper() -> None:
    monitor = ArcLength(u=PAPER, scaled=False)
    fine = equidistribution(uniform(12), monitor, gauss=20)
    assert np.abs(equidistribution(uniform(12), monitor) - fine).max() < 1e-9
    assert np.abs(equidistribution(uniform(12), monitor, gauss=4) - fine).max() > 1e-9


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


# Measures of the shape of cells: exact values on cells made by hand.


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
    tiled = Mesh(np.repeat(columns[:, None], 4, axis=1), np.stack([low, high, high + 1 / 3, high + 2 / 3], axis=1))
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


# The measures of a mesh of blocks: those of a grid where it is one, and what only blocks have.


MONITOR = em.ArcLength(u=TANH20, scaled=False)


@pytest.mark.parametrize("kind", ["quad", "triangle"])
@pytest.mark.parametrize("shape", [(13, 9), (61, 45)])
def test_a_grid_as_blocks_has_the_quality_of_the_grid(shape: tuple[int, int], kind: str) -> None:
    grid, plain = wavy(*shape), uniform(*shape)
    turned = kind == "quad"  # of two equal diagonals the one from the first corner is taken
    whole, before = in_blocks(grid, turned=turned), in_blocks(plain, turned=turned)
    expected = measure_all(grid, MONITOR, kind=kind)
    found = measure_all(whole.mesh, MONITOR, uniform=before.mesh, kind=kind)
    for name in PER_CELL:
        values = getattr(found, name).cells
        assert values.shape == whole.mesh.cell_shape
        assert values == pytest.approx(getattr(expected, name).cells.ravel()[whole.cells], rel=1e-11), name
        assert getattr(found, name).rms == pytest.approx(getattr(expected, name).rms, rel=1e-12)
    assert found.min_jacobian == pytest.approx(expected.min_jacobian, rel=1e-12)
    assert found.interpolation_error is not None
    for name in ERRORS:
        there = getattr(expected.interpolation_error, name)
        assert getattr(found.interpolation_error, name) == pytest.approx(there, rel=1e-9), name
    assert isinstance(found.summary(arrays=True)["q_geo"]["cells"][0], float)


def test_threads_and_single_measures_agree() -> None:
    mesh = in_blocks(wavy(150, 141)).mesh
    two = measure_all(mesh, MONITOR, uniform=mesh, threads=2)
    assert two.q_eq.cells == pytest.approx(equidistribution(mesh, MONITOR), rel=1e-14)
    assert two.q_ali.cells == pytest.approx(alignment(mesh, MONITOR), rel=1e-14)
    assert two.q_geo.cells == pytest.approx(shape_regularity(mesh), rel=1e-14)
    assert two.interpolation_error.gain_l2 == 1.0


def test_a_field_in_place_of_a_monitor_is_refused() -> None:
    mesh = wavy(5, 5)
    with pytest.raises(InputError, match="is no monitor: give one"):
        measure(mesh, TANH20)
    with pytest.raises(InputError, match="is no monitor: give one"):
        measure_each(mesh, [MONITOR, TANH20])


def test_fields_that_share_a_mesh_share_its_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh, found, of = wavy(61, 45), [], Shapes.of
    monitors = [em.ArcLength(u=u, scaled=False) for u in (TANH20, em.Expression("x*y"), em.Expression("sin(9*x)"))]
    expected = [measure(mesh, monitor) for monitor in monitors]
    monkeypatch.setattr(Shapes, "of", lambda *args, **kwargs: found.append(args) or of(*args, **kwargs))
    for one, other in zip(measure_each(mesh, monitors), expected, strict=True):
        assert one.summary(arrays=True) == other.summary(arrays=True)
        assert np.array_equal(one.u, other.u)
    assert len(found) == 1
    assert expected[0].q_eq.max != expected[1].q_eq.max


def test_without_a_mesh_to_compare_with_there_is_no_gain() -> None:
    mesh = l_shape()
    found = measure(mesh, MONITOR).interpolation_error
    assert found.l2 == pytest.approx(measure_errors(mesh, TANH20).l2, rel=0.05)
    assert math.isnan(found.l2_uniform)
    assert math.isnan(found.gain_l2)
    assert measure(mesh, MONITOR).summary()["interpolation_error"]["gain_l2"] is None
    assert math.isnan(triangle_errors(mesh, TANH20).gain_l2)
    for other in (l_shape(4), wavy()):
        with pytest.raises(InputError, match="compare it with the mesh that it began with"):
            measure_errors(mesh, TANH20, uniform=other)


def test_a_folded_cell_spoils_what_it_touches() -> None:
    whole = in_blocks(folded())
    quality = measure(whole.mesh, MONITOR, uniform=whole.mesh)
    expected = measure(folded(), MONITOR)
    for name in ("q_eq", "q_geo", "size_ratio"):
        found = getattr(quality, name).cells
        assert np.array_equal(np.isinf(found), np.isinf(getattr(expected, name).cells.ravel()[whole.cells])), name
    assert quality.interpolation_error.l2 == math.inf
    broken = changed(whole.mesh, points=np.where(np.arange(36)[:, None] == 7, np.nan, whole.mesh.points))
    assert not cells_of(broken).all_valid


def test_cells_across_a_join_are_neighbours() -> None:
    """The cells at both ends of the channel differ in size from those next to them by the join alone."""
    mesh = channel()
    x = mesh.points[:, 0].copy()
    x[mesh.blocks[0][1]] -= 0.5 * (x[mesh.blocks[0][1]] - x[mesh.blocks[0][0]])
    narrow = mesh.moved(np.column_stack([x, mesh.points[:, 1]]))
    ratios = measure(narrow, em.ArcLength(u=SLOPE, scaled=False)).size_ratio.cells[narrow.block_cells[0]]
    cut = changed(narrow, ties=mesh.ties[:0])
    apart = measure(cut, em.ArcLength(u=SLOPE, scaled=False)).size_ratio.cells[narrow.block_cells[0]]
    assert ratios[-1] == pytest.approx(np.full(4, 2.0), rel=0.2)
    assert apart[-1] == pytest.approx(np.full(4, 1.0), rel=0.2)
    assert ratios[1:-1] == pytest.approx(apart[1:-1])


def test_a_sample_of_many_cells_gives_the_errors_of_all() -> None:
    mesh, plain = in_blocks(wavy(460, 400)).mesh, in_blocks(uniform(460, 400)).mesh
    cells = QuadCells(mesh)
    numbers = sample(cells.rows)
    assert MIN_SAMPLED_CELLS <= numbers.size <= 3 * MIN_SAMPLED_CELLS
    found = measure_errors(mesh, TANH20, uniform=plain)
    tally = ErrorTally.of(cells, TANH20, ErrorRule.lean())
    tally.add_all(2)
    assert found.l2 == pytest.approx(math.sqrt(tally.sums[0].sum()), rel=0.01)


def test_probes_find_the_largest_error_of_a_spike() -> None:
    u = em.Expression("exp(-400*((x - 0.613)**2 + (y - 0.307)**2))")
    grid = wavy(31, 21)
    (error, x, y), variation = probe_errors(in_blocks(grid).mesh, u)
    expected, of_grid = probe_errors(grid, u)
    assert (error, variation) == pytest.approx((expected.value, of_grid), rel=0.05)
    assert math.hypot(x - expected.x, y - expected.y) < 0.1


def test_corners_areas_and_values() -> None:
    grid = wavy()
    whole = in_blocks(grid)
    cells, plain = QuadCells(whole.mesh), BilinearCells(grid)
    assert cells.area == pytest.approx(plain.area[whole.cells], rel=1e-12)
    assert cells.total_area == pytest.approx(plain.total_area, rel=1e-12)
    chosen = np.array([0, 5, 70])
    corners = cells.corners(chosen)
    assert cells.corner_values(whole.mesh.x, chosen) == pytest.approx(corners[:4])
    turned = [sorted(zip(column[:4], column[4:], strict=True)) for column in corners.T]
    there = [sorted(zip(column[:4], column[4:], strict=True)) for column in plain.corners(whole.cells[chosen]).T]
    assert turned == there
    assert {*cells.cuts} == {int(np.flatnonzero(whole.cells == k)[0]) for k in plain.cuts}
    assert isinstance(cells_of(grid), BilinearCells)
