"""Loops over cells: corners by number, and points inside."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.quality.cell_maps import (
    gather_cells,
    gather_row_of_cells,
    gather_values,
    locate,
    map_cells,
    measure_cells,
)
from solver.quality.handmade import folded, wavy

MESH = wavy(7, 6)


def corners(numbers: np.ndarray) -> np.ndarray:
    out = np.empty((8, numbers.size))
    gather_cells(MESH.x, MESH.y, numbers, out)
    return out


def test_corners_of_consecutive_cells_are_those_of_their_numbers() -> None:
    out = np.empty((8, 13))
    gather_row_of_cells(MESH.x, MESH.y, 3, out)
    assert np.array_equal(out, corners(np.arange(3, 16)))
    assert np.array_equal(
        corners(np.array([11])).ravel(), [*MESH.x.ravel()[MESH.cells[11]], *MESH.y.ravel()[MESH.cells[11]]]
    )
    values = np.empty((4, 13))
    gather_values(MESH.x, np.arange(3, 16), values)
    assert np.array_equal(values, out[:4])


def test_points_of_a_cell_lie_where_its_map_puts_them() -> None:
    cells, s, t = corners(np.arange(30)), np.array([0.0, 1.0, 0.25]), np.array([0.0, 1.0, 0.5])
    x, y = np.empty((2, 3, 30))
    locate(cells, s, t, x, y)
    assert np.array_equal(x[:2], cells[[0, 2]])
    assert np.array_equal(y[:2], cells[[4, 6]])
    out = np.empty((7, 3, 30))
    map_cells(cells, s, t, out)
    assert np.array_equal(out[:2], np.stack([x, y]))
    assert out[6] == pytest.approx(out[2] * out[5] - out[4] * out[3])
    assert np.array_equal(out[2, 0], cells[1] - cells[0])


def test_areas_are_those_of_polygons_and_folds_are_found() -> None:
    area, valid = np.empty(30), np.empty(30, dtype=np.bool_)
    lowest = measure_cells(MESH.x, MESH.y, area, valid)
    x, y = corners(np.arange(30)).reshape(2, 4, 30)
    assert area == pytest.approx(0.5 * ((x[2] - x[0]) * (y[3] - y[1]) - (x[3] - x[1]) * (y[2] - y[0])))
    assert valid.all()
    assert lowest == pytest.approx(MESH.corner_jacobians().min() / 30)
    mesh = folded()
    assert measure_cells(mesh.x, mesh.y, area[:25], valid[:25]) < 0.0
    assert 0 < valid[:25].sum() < 25
    broken = MESH.x.copy()
    broken[3, 3] = np.inf
    assert np.isnan(measure_cells(broken, MESH.y, area, valid))
