"""The compiled bicubic spline is FITPACK's, also in tiles."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline, RectBivariateSpline, make_interp_spline

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.fields import bicubic, chunked_samples
from equimesh.fields.bicubic import ORDER, Axis, Bicubic, at_piece, buckets_per_length, piece
from equimesh.fields.chunked_samples import Tiles, tile_count, tile_of, window

PARTIALS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))


@pytest.mark.parametrize(("n_x", "n_y", "grading"), [(4, 4, 1.0), (5, 7, 1.0), (33, 50, 3.0), (40, 6, 6.0)])
def test_it_is_fitpacks(n_x: int, n_y: int, grading: float) -> None:
    random = np.random.default_rng(7)
    x, y = np.linspace(0.0, 1.0, n_x) ** grading, np.linspace(-2.0, 3.0, n_y)
    spline = RectBivariateSpline(x, y, random.standard_normal((n_x, n_y)), s=0)
    points = [np.concatenate([axis, random.uniform(axis[0] - 0.3, axis[-1] + 0.3, 500)]) for axis in (x, y)]
    first, second = np.meshgrid(*points, indexing="ij")
    found = Bicubic.of(spline).evaluate(first, second, order=2)
    for values, (dx, dy) in zip(found, PARTIALS, strict=True):
        expected = spline(first, second, dx=dx, dy=dy, grid=False)
        assert np.abs(values - expected).max() <= 1e-13 * np.abs(expected).max()


def test_beyond_the_ends_and_nowhere() -> None:
    axis = np.linspace(0.0, 1.0, 6)
    bicubic = Bicubic.of(RectBivariateSpline(axis, axis, np.add.outer(axis, 2.0 * axis), s=0))
    x, y = np.array([-np.inf, 7.0, np.nan, 0.5]), np.array([0.25, np.inf, 0.5, np.nan])
    values, slope, _ = bicubic.evaluate(x, y, order=1)
    np.testing.assert_allclose(values[:2], [0.5, 3.0], atol=1e-14)
    np.testing.assert_allclose(slope[:2], 1.0, atol=1e-13)
    assert np.isnan(values[2:]).all()
    assert np.isnan(slope[2:]).all()


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("bad", [0.5, np.nan], ids=["finite", "nowhere"])
def test_where_lines_cross_it_is_what_it_is_at_points(order: int, bad: float) -> None:
    x, y = np.linspace(0.0, 1.0, 9) ** 2, np.linspace(-1.0, 2.0, 6)
    bicubic = Bicubic.of(RectBivariateSpline(x, y, np.random.default_rng(5).standard_normal((9, 6)), s=0))
    first, second = np.array([0.3, -0.2, bad, 1.0, 7.0]), np.array([2.5, 0.1, -1.0, 2.0, -8.0, 0.1, 0.7])
    expected = bicubic.evaluate(*np.meshgrid(first, second, indexing="ij"), order)
    found = bicubic.evaluate(first[:, None], second[None], order)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert bicubic.evaluate(first[:0, None], second[None], order)[0].shape == (0, 7)
    assert bicubic.evaluate(first[:, None], second[None, :0], order)[0].shape == (5, 0)


def test_slopes_are_bounded_as_fitpack_bounds_them() -> None:
    x, y = np.linspace(0.0, 1.0, 9) ** 2, np.linspace(-1.0, 2.0, 6)
    spline = RectBivariateSpline(x, y, np.random.default_rng(5).standard_normal((9, 6)), s=0)
    expected = [np.abs(spline.partial_derivative(*by).get_coeffs()).max() for by in ((1, 0), (0, 1))]
    np.testing.assert_allclose(Bicubic.of(spline).steepest, expected, rtol=1e-12)


# The pieces of an axis: every point lies on the piece that a search finds.


def knots_of(points: np.ndarray) -> np.ndarray:
    return np.asarray(make_interp_spline(points, points).t)


@pytest.mark.parametrize("power", [1.0, 6.0], ids=["even", "graded"])
def test_every_point_has_its_piece(power: float) -> None:
    axis = Axis.of(knots_of(np.linspace(0.0, 1.0, 40) ** power))
    scale = buckets_per_length(axis)
    last = axis.breaks.size - 2
    for t in [*axis.breaks, *np.random.default_rng(1).random(300), *np.nextafter(axis.breaks[1:], 0.0)]:
        expected = min(int(np.searchsorted(axis.breaks, t, side="right")) - 1, last)
        assert piece(t, axis, scale) == expected


def test_the_cubics_are_the_b_splines() -> None:
    knots = knots_of(np.linspace(0.0, 2.0, 9) ** 1.5)
    axis = Axis.of(knots)
    for number, begin in enumerate(axis.breaks[:-1]):
        t = 0.3 * begin + 0.7 * axis.breaks[number + 1]
        expected = BSpline.design_matrix([t], knots, 3).toarray()[0, number : number + ORDER]
        assert at_piece(axis.cubics, number, t - begin) == pytest.approx(expected, abs=1e-14)


# Polynomials on rectangles are the spline of the B-splines that they are made from.


def spline() -> Bicubic:
    x, y = np.linspace(0.0, 2.0, 23) ** 1.5, np.linspace(-1.0, 1.0, 17)
    values = np.random.default_rng(3).standard_normal((23, 17))
    return Bicubic.of(RectBivariateSpline(x, y, values, s=0))


@pytest.mark.parametrize("order", [0, 1, 2])
def test_both_ways_of_evaluation_agree(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    rng = np.random.default_rng(order)
    points = rng.uniform(-0.2, 3.2, 4000), rng.uniform(-1.2, 1.2, 4000)  # some outside
    by_patches = spline().evaluate(*points, order)
    monkeypatch.setattr(bicubic, "MAX_PATCHES", 0)
    by_splines = spline().evaluate(*points, order)
    assert len(by_patches) == len(by_splines) == (1, 3, 6)[order]
    for first, second in zip(by_patches, by_splines, strict=True):
        assert np.abs(first - second).max() < 1e-12 * np.abs(second).max()
        assert (first != second).any(), "these are two ways"


def test_a_spline_that_was_used_pickles_without_its_polynomials() -> None:
    used, unused = spline(), spline()
    expected = used.evaluate(np.array([0.7]), np.array([0.2]))
    assert len(pickle.dumps(used)) == len(pickle.dumps(unused))
    assert pickle.loads(pickle.dumps(used)).evaluate(np.array([0.7]), np.array([0.2])) == expected


@pytest.mark.parametrize("order", [0, 1, 2])
def test_values_on_a_mesh_are_those_by_splines(monkeypatch: pytest.MonkeyPatch, order: int) -> None:
    start = em.Mesh.uniform(em.Grid(n_xi=20, n_eta=15))
    bump = np.sin(np.pi * start.x) * np.sin(np.pi * start.y)
    mesh = em.Mesh(start.x + 0.1 * bump, start.y - 0.08 * bump)
    values = np.tanh(5.0 * (mesh.x + mesh.y - 1.0))
    points = np.random.default_rng(order).uniform(-0.01, 1.01, (2, 500))  # some outside
    by_patches = em.NodalField(mesh=mesh, values=values).evaluate(*points, order)
    monkeypatch.setattr(bicubic, "MAX_PATCHES", 0)
    by_splines = em.NodalField(mesh=mesh, values=values).evaluate(*points, order)
    for first, second in zip(by_patches, by_splines, strict=True):
        assert np.abs(first - second).max() < 1e-11 * np.abs(second).max()
        assert (first != second).any(), "these are two ways"


RANDOM = np.random.default_rng(7)
X, Y = np.linspace(0, 1, 151) ** 1.3, np.linspace(0, 1, 110)
VALUES = np.tanh(20 * (X[:, None] - Y**2)) + 0.3 * RANDOM.standard_normal((151, 110))
POINTS = RANDOM.random((2, 40, 30))
# As good as equal: the influence of what a window leaves out, and rounding.
CLOSE = 3e-14


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Tiles of 40 samples: 4 by 3 of them. The windows that are read."""
    monkeypatch.setattr(chunked_samples, "TILE", 40)
    return []


def tiled(windows: list[Any], max_bytes: int = 1 << 30, values: np.ndarray = VALUES) -> Tiles:
    def read(rows: slice, columns: slice) -> np.ndarray:
        windows.append((rows, columns))
        return values[rows, columns]

    return Tiles((X, Y), read, max_bytes)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_values_and_derivatives_are_those_of_the_whole_spline(small: list[Any], order: int) -> None:
    whole = em.GridSamples(x=X, y=Y, values=VALUES).evaluate(*POINTS, order)
    for found, expected in zip(tiled(small).evaluate(*POINTS, order), whole, strict=True):
        assert found.shape == POINTS.shape[1:]
        assert np.abs(found - expected).max() <= CLOSE * np.abs(expected).max()
    assert len(small) == 12


def test_without_a_margin_they_are_not(small: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked_samples, "MARGIN", 12)
    (whole,) = em.GridSamples(x=X, y=Y, values=VALUES).evaluate(*POINTS)
    (found,) = tiled(small).evaluate(*POINTS)
    assert np.abs(found - whole).max() > 100 * CLOSE


def test_a_value_does_not_depend_on_other_points_or_on_memory(small: list[Any]) -> None:
    much, little = tiled([]), tiled(small, max_bytes=1)
    everything = much.evaluate(*POINTS, 2)
    for found, expected in zip(little.evaluate(*POINTS, 2), everything, strict=True):
        np.testing.assert_array_equal(found, expected)
    for k in range(10):
        alone = tiled([]).evaluate(POINTS[0, 0, k], POINTS[1, 0, k], 2)
        assert [float(value) for value in alone] == [float(value[0, k]) for value in everything]


def test_only_some_splines_are_kept(small: list[Any]) -> None:
    bytes_of_one = 43 * 43 * 8
    kept = tiled(small, max_bytes=3 * bytes_of_one)
    kept.evaluate(*POINTS)
    kept.evaluate(*POINTS)
    assert len(small) > 12  # computed again
    assert 2 * bytes_of_one < kept.kept_bytes <= 3 * bytes_of_one
    near = np.full(5, 0.01)
    for _ in range(3):
        kept.evaluate(near, near)
    assert len([where for where in small if where == small[0]]) <= 3  # those used last stay


def test_points_at_breaks_on_the_rim_and_beyond_it(small: list[Any]) -> None:
    whole = em.GridSamples(x=X, y=Y, values=VALUES)
    x = np.array([0.0, 1.0, X[40], X[80], np.nextafter(X[80], 0), -3.0, 7.0, 0.5])
    y = np.array([0.0, 1.0, Y[40], Y[79], Y[80], 0.5, 2.0, -1.0])
    for found, expected in zip(tiled(small).evaluate(x, y, 1), whole.evaluate(x, y, 1), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert np.isnan(tiled(small).evaluate(np.array([np.nan, 0.5]), np.array([0.5, 0.5]))[0]).tolist() == [True, False]
    assert tiled(small).evaluate(np.empty((0, 3)), np.empty((0, 3)), 2)[5].shape == (0, 3)


def test_threads_share_it(small: list[Any]) -> None:
    shared = tiled(small, max_bytes=40_000)
    expected = tiled([]).evaluate(*POINTS, 1)
    with ThreadPoolExecutor(4) as threads:
        for found in threads.map(lambda _: shared.evaluate(*POINTS, 1), range(12)):
            for value, right in zip(found, expected, strict=True):
                np.testing.assert_array_equal(value, right)
    assert shared.kept_bytes <= 40_000


def test_a_bad_sample_is_named_by_its_index_in_the_whole_array(small: list[Any]) -> None:
    values = VALUES.copy()
    values[97, 100] = np.nan
    spoiled = tiled(small, values=values)
    assert np.all(np.isfinite(spoiled.evaluate(np.array(0.1), np.array(0.1))[0]))  # in another window
    with pytest.raises(SamplesError, match=r"values\[97\]\[100\] is NaN"):
        spoiled.evaluate(np.array(0.7), np.array(0.9))


def test_few_samples_are_one_tile() -> None:
    for count in (2, 3, 4):
        axis = np.linspace(0, 1, count)
        values = axis[:, None] ** min(2, count - 1) * np.ones(count)
        found = Tiles((axis, axis), lambda rows, columns, v=values: v[rows, columns], 1).evaluate(*POINTS, 1)
        whole = em.GridSamples(x=axis, y=axis, values=values).evaluate(*POINTS, 1)
        np.testing.assert_allclose(found, whole, rtol=0, atol=1e-14)


def test_tiles_and_windows_of_an_axis() -> None:
    assert [tile_count(samples) for samples in (2, 513, 514, 1025)] == [1, 1, 2, 2]
    assert window(2000, 0) == (slice(0, 545), (0, 512))
    assert window(2000, 1) == (slice(480, 1057), (512, 1024))
    assert window(1026, 2) == (slice(992, 1026), (1024, 1025))
    axis = np.arange(1026.0)
    assert tile_of(axis, np.array([-5, 0, 511.9, 512, 1023.9, 1024, 1025, 9e9])).tolist() == [0, 0, 0, 1, 1, 2, 2, 2]
    assert tile_of(np.arange(513.0), np.array([0, 512, 600.0])).tolist() == [0, 0, 0]
