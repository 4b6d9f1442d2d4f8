"""Splines in tiles: the spline through everything, whatever the tiles, their number in memory, and the threads."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import SamplesError
from equimesh.fields import chunked_samples
from equimesh.fields.chunked_samples import Tiles, tile_count, tile_of, window

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
