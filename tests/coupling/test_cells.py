"""Values on cells."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh import Mesh
from equimesh_coupling import BadValues, CellAverages, ErrorIndicator, MeshParts, cell_values


def test_one_value_for_each_quadrilateral_is_taken_as_it_is(quads: MeshParts, mesh: Mesh) -> None:
    values = np.arange(24.0)
    for shape in ((24,), (6, 4), (24, 1)):
        for wrapped in (CellAverages(values.reshape(shape)), ErrorIndicator(values.reshape(shape))):
            assert np.array_equal(cell_values(wrapped, quads), values.reshape(6, 4))
            assert np.array_equal(cell_values(wrapped, mesh), values.reshape(6, 4))


def test_triangles_are_merged_by_area_and_indicators_by_squares(triangles: MeshParts, mesh: Mesh) -> None:
    values = np.arange(48.0)
    corners = triangles.points[triangles.cells]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.det(edges) / 2
    means = (values * areas).reshape(-1, 2).sum(axis=1) / areas.reshape(-1, 2).sum(axis=1)
    for which in (triangles, mesh):
        assert np.allclose(cell_values(CellAverages(values), which).ravel(), means)
        roots = np.hypot(values[::2], values[1::2])
        assert np.allclose(cell_values(ErrorIndicator(values), which).ravel(), roots)


def test_bad_values_are_refused(quads: MeshParts) -> None:
    with pytest.raises(BadValues, match="the error indicator has negative values"):
        cell_values(ErrorIndicator(-np.ones(24)), quads)
    with pytest.raises(BadValues, match="cell averages has 1 of 24 values that are nan"):
        cell_values(CellAverages([np.nan, *np.ones(23)]), quads)
    with pytest.raises(BadValues, match=r"indicator has 35 values of shape .*, and this mesh has 24 quad"):
        cell_values(ErrorIndicator(np.ones(35)), quads)


def test_cells_in_another_order_are_refused(quads: MeshParts) -> None:
    values = np.arange(24.0).reshape(6, 4)
    assert np.array_equal(cell_values(CellAverages(values), quads), values)
    with pytest.raises(BadValues, match=r"24 values of shape \(4, 6\).*of shape \(6, 4\)"):
        cell_values(CellAverages(values.T), quads)
