"""What solvers return."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from equimesh import Mesh
from equimesh_coupling import (
    BadValues,
    CellAverages,
    ErrorIndicator,
    MeshParts,
    cell_values,
    element_values,
    node_values,
)
from equimesh_coupling.values import READERS


def test_nodal_values_are_taken_in_the_order_of_the_nodes(mesh: Mesh, parts: MeshParts) -> None:
    u = mesh.x + 2 * mesh.y
    for which in (mesh, parts):
        for returned in (u, u.ravel(), u.reshape(-1, 1), u.reshape(1, -1), u.tolist(), u.astype(np.float32)):
            found = node_values(returned, which)
            assert found.shape == (7, 5)
            assert found.dtype == np.float64
            assert np.allclose(found, u)


def test_cell_averages_are_recovered(quads: MeshParts) -> None:
    assert np.allclose(node_values(CellAverages(np.full(24, 3.0)), quads), 3.0)


@pytest.mark.parametrize("count", [24, 48])
def test_cell_averages_given_as_nodal_are_refused(count: int, parts: MeshParts) -> None:
    with pytest.raises(BadValues) as caught:
        node_values(np.ones(count), parts)
    assert str(caught.value) == (
        f"the solution has {count} values, one for each cell, and needs one for each of the 35 nodes: wrap averages "
        "over cells in CellAverages(values), an error indicator in ErrorIndicator(values)"
    )


@pytest.mark.parametrize(
    ("returned", "sentence"),
    [
        (np.ones(36), r"the solution has the shape \(36,\), and needs one value for each of the 35 nodes: return an"),
        (np.ones((5, 7)), r"the solution has the shape \(5, 7\), .*an array of shape \(7, 5\), or flat"),
        (np.float64(1.0), r"the solution has the shape \(\)"),
        (np.full((7, 5), np.nan), "35 of 35 values that are nan or infinite, so the solver diverged"),
        (np.full(35, 1j), "complex numbers"),
        (None, "the solution is None: a solver has to return its values"),
        (ErrorIndicator(np.ones(24)), "an error indicator is no solution"),
    ],
)
def test_what_cannot_be_used_is_refused(returned: Any, sentence: str, quads: MeshParts) -> None:
    with pytest.raises(BadValues, match=sentence):
        node_values(returned, quads)


@pytest.mark.parametrize(("package", "name"), READERS)
def test_a_field_is_known_by_the_names_of_its_types(
    package: str, name: str, quads: MeshParts, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = type(name, (), {"__module__": f"{package}.somewhere"})
    derived = type("Own", (base,), {"__module__": "mine"})
    monkeypatch.setitem(READERS, (package, name), lambda _, mesh: np.full(mesh.mesh_parts().shape, 7.0))
    assert (node_values(derived(), quads) == 7.0).all()
    monkeypatch.setitem(READERS, (package, name), lambda _, mesh: np.full(mesh.mesh_parts().shape, np.inf))
    with pytest.raises(BadValues, match="diverged"):
        node_values(base(), quads)
    stranger = type(name, (), {"__module__": ModuleType("other").__name__})
    with pytest.raises(BadValues, match=f"the solution is a other.{name}"):
        node_values(stranger(), quads)


# Values on cells.


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


def test_arrays_of_degree_2_are_taken_with_two_axes_or_flat(quads: MeshParts) -> None:
    u = np.arange(117.0).reshape(13, 9)
    for returned in (u, u.ravel(), u.reshape(-1, 1)):
        found = element_values(returned, quads, 2)
        assert found.degree == 2
        assert np.array_equal(found.values, u)
    assert element_values(np.ones(35), quads).degree == 1


@pytest.mark.parametrize(
    ("returned", "sentence"),
    [
        (
            np.ones((7, 5)),
            r"shape \(7, 5\), and elements of degree 2 have 117 nodes .* of shape \(13, 9\)",
        ),
        (CellAverages(np.ones(24)), "values of cells say nothing of elements of degree 2"),
        (np.full(117, np.inf), "117 of 117 values that are nan or infinite"),
    ],
)
def test_what_elements_of_degree_2_cannot_have_is_refused(returned: Any, sentence: str, quads: MeshParts) -> None:
    with pytest.raises(BadValues, match=sentence):
        element_values(returned, quads, 2)
