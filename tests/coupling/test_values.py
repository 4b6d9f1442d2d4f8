"""What solvers return: values at nodes, averages over cells, elements of degree 2, and arrays from outside."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from block_cases import in_blocks, l_shape
from coupling.conftest import bent
from equimesh import Mesh
from equimesh.meshes.second_order import SecondOrderMesh, lattice_of
from equimesh_coupling import (
    BadValues,
    CellAverages,
    ErrorIndicator,
    MeshParts,
    cell_values,
    element_points,
    element_values,
    node_values,
)
from equimesh_coupling.arrays import finite, real
from equimesh_coupling.elements import PlacedValues, at_elements, element_shape
from equimesh_coupling.recovery import cells_near_nodes, edge_numbers, nodes_from_cells, unique_edges
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
        (np.ones((7, 5)), r"shape \(7, 5\), and elements of degree 2 have 117 nodes .* of shape \(13, 9\)"),
        (CellAverages(np.ones(24)), "values of cells say nothing of elements of degree 2"),
        (np.full(117, np.inf), "117 of 117 values that are nan or infinite"),
    ],
)
def test_what_elements_of_degree_2_cannot_have_is_refused(returned: Any, sentence: str, quads: MeshParts) -> None:
    with pytest.raises(BadValues, match=sentence):
        element_values(returned, quads, 2)


def centroids(mesh: Mesh, cells: str) -> np.ndarray:
    """The centroids of the cells, by a fan of triangles."""
    parts = mesh.mesh_parts(cells)  # type: ignore[arg-type]
    corners = parts.points[parts.cells]
    fans = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
    areas = np.stack([np.linalg.det(fan[:, 1:] - fan[:, :1]) for fan in fans])
    return (areas[..., None] * np.stack([fan.mean(axis=1) for fan in fans])).sum(axis=0) / areas.sum(axis=0)[:, None]


@pytest.mark.parametrize("cells", ["quad", "triangle"])
def test_a_linear_function_is_recovered_without_error(mesh: Mesh, cells: str) -> None:
    x, y = centroids(mesh, cells).T
    found = nodes_from_cells(CellAverages(2 + 3 * x - 5 * y), mesh)
    assert abs(found - (2 + 3 * mesh.x - 5 * mesh.y)).max() < 1e-12


def test_a_smooth_function_is_recovered_to_second_order() -> None:
    errors = []
    for n in (17, 33, 65):
        xi, eta = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
        mesh = Mesh(xi + 0.1 * np.sin(3 * eta), eta + 0.2 * xi**2)
        x, y = centroids(mesh, "quad").T
        errors.append(abs(nodes_from_cells(CellAverages(np.sin(3 * x) * y**2), mesh) - np.sin(3 * mesh.x) * mesh.y**2))
    largest = [error.max() for error in errors]
    assert largest[0] / largest[1] > 3.5
    assert largest[1] / largest[2] > 3.5
    assert largest[2] < 2e-3


def test_thin_cells_do_no_harm() -> None:
    s = np.linspace(0, 1, 9) ** 6
    mesh = Mesh(*np.meshgrid(s, s, indexing="ij"))
    x, y = centroids(mesh, "quad").T
    assert abs(nodes_from_cells(CellAverages(x - y), mesh) - (mesh.x - mesh.y)).max() < 1e-12


def test_two_rows_of_cells_are_needed() -> None:
    mesh = Mesh(*np.meshgrid([0.0, 1.0], [0.0, 0.5, 1.0], indexing="ij"))
    with pytest.raises(BadValues, match="at least 3 nodes on each side"):
        nodes_from_cells(CellAverages([1.0, 2.0]), mesh)


# Edges of a mesh, every one once.


def test_every_edge_is_there_once(parts: MeshParts) -> None:
    edges, of_cells = unique_edges(parts.cells)
    assert len(parts.points) - len(edges) + len(parts.cells) == 1  # Euler's formula
    assert len({frozenset(edge) for edge in edges.tolist()}) == len(edges)
    ahead = np.stack([parts.cells, np.roll(parts.cells, -1, axis=1)], axis=2)
    assert np.array_equal(np.sort(edges[of_cells], axis=2), np.sort(ahead, axis=2))
    inner = np.bincount(of_cells.ravel())
    assert set(inner) == {1, 2}
    assert (inner == 1).sum() == sum(map(len, parts.sides.values()))


def test_an_edge_is_found_in_either_direction(parts: MeshParts) -> None:
    edges, _ = unique_edges(parts.cells)
    wanted = np.array([5, 0, 17])
    assert edge_numbers(edges[wanted], edges).tolist() == [5, 0, 17]
    assert edge_numbers(edges[wanted][:, ::-1], edges).tolist() == [5, 0, 17]


# The cells near each node of a mesh of blocks, and values at the nodes from averages over them.


def near(cells: np.ndarray, count: int) -> dict[int, set[int]]:
    return {
        node: {*found}
        for nodes, table in cells_near_nodes(cells, count)
        for node, found in zip(nodes.tolist(), table.tolist(), strict=True)
    }


def test_inner_nodes_have_the_cells_around_them_and_outer_ones_their_neighbours_too() -> None:
    mesh = l_shape(5)
    found = near(mesh.cells, 65)
    around = {node: {*np.flatnonzero((mesh.cells == node).any(axis=1)).tolist()} for node in range(65)}
    outer = {*np.concatenate([*mesh.sides.values()]).ravel().tolist()}
    for node in range(65):
        assert found[node] == around[node] if node not in outer else found[node] > around[node], node
    corner = int(mesh.blocks[0][0, 0])
    low = mesh.block_cells[0]
    assert found[corner] == {low[0, 0], low[1, 0], low[0, 1]}
    inward = int(mesh.blocks[0][-1, -1])  # the corner that points into the domain has three cells around it
    assert len(around[inward]) == 3
    assert len(found[inward]) == 3 + 6


def test_a_linear_function_is_recovered_from_its_averages() -> None:
    mesh = in_blocks(bent()).mesh
    parts = mesh.mesh_parts()
    x, y = parts.points[parts.mesh_parts("triangle").cells].mean(axis=1).T
    assert node_values(CellAverages(3 * x - y + 2), mesh) == pytest.approx(3 * mesh.x - mesh.y + 2)


def test_patches_recover_a_smooth_function_to_second_order() -> None:
    errors = []
    for n in (9, 17, 33):
        mesh = l_shape(n)
        x, y = mesh.points[mesh.cells].mean(axis=1).T
        found = node_values(CellAverages(np.sin(2 * x) * np.cos(y)), mesh)
        errors.append(np.abs(found - np.sin(2 * mesh.x) * np.cos(mesh.y)).max())
    assert errors[0] / errors[1] > 3.2
    assert errors[1] / errors[2] > 3.5
    assert errors[2] < 4e-3


def test_one_cell_gives_no_plane() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    one = MeshParts(points=points, cells=np.array([[0, 1, 2, 3]]), sides={}, shape=None)
    with pytest.raises(BadValues, match="node 0 has 1 cells near it"):
        node_values(CellAverages([1.0]), one)


def test_nodes_of_a_grid_are_those_of_its_lattice(mesh: Mesh, parts: MeshParts) -> None:
    assert element_shape(parts, 1) == (7, 5)
    assert element_shape(parts, 2) == (13, 9)
    assert np.array_equal(element_points(parts, 1), mesh.points)
    np.testing.assert_allclose(element_points(parts, 2), lattice_of(mesh).points, atol=1e-15)


@pytest.mark.parametrize("blocks", [False, True])
def test_nodes_of_quadratic_triangles_have_the_middles_of_the_cuts_for_the_centres(mesh: Mesh, blocks: bool) -> None:
    cut = l_shape() if blocks else mesh
    second, points = SecondOrderMesh.of(cut.points, cut.cells), element_points(cut, 2, "triangle")
    own = second.triangles(cut.triangles())
    corners = cut.points[cut.triangles()]
    wanted = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1)
    if blocks:  # in the order of the file of second order
        np.testing.assert_allclose(points[own], wanted, atol=1e-15)
    np.testing.assert_allclose(np.unique(points.round(12), axis=0), np.unique(wanted.reshape(-1, 2).round(12), axis=0))
    assert np.array_equal(element_points(cut, 1, "triangle"), cut.points)


def test_values_of_quadratic_triangles_are_refused_with_their_number_and_order(quads: MeshParts) -> None:
    with pytest.raises(BadValues, match=r"2 on triangles have 117 .* \(13, 9\), or .*points\(mesh, 2, .triangle"):
        element_values(np.ones(35), quads, 2, "triangle")


def test_nodes_of_blocks_are_in_the_order_of_files_of_second_order() -> None:
    mesh = l_shape()
    second = SecondOrderMesh.of(mesh.points, mesh.cells)
    assert element_shape(mesh, 2) == (len(second.points),)
    np.testing.assert_allclose(element_points(mesh, 2), second.points, atol=1e-15)


def test_values_are_found_by_their_places_to_rounding(quads: MeshParts) -> None:
    points = element_points(quads, 2)
    order = np.random.default_rng(3).permutation(len(points))
    moved = points[order] * (1.0 + 1e-14) - 1e-14
    found = at_elements(PlacedValues(moved, points[order] @ [1.0, 2.0]), quads)
    np.testing.assert_array_equal(found, (points @ [1.0, 2.0]).reshape(13, 9))


def test_nodes_without_a_value_are_counted(quads: MeshParts) -> None:
    points = element_points(quads, 2)
    with pytest.raises(BadValues, match="the field has 115 values, and none at 2 of the 117 nodes that"):
        at_elements(PlacedValues(points[2:], np.ones(115)), quads)


def test_numbers_become_floats() -> None:
    assert real([1, 2], "u").dtype == np.float64
    assert finite(real([[1.5]], "u"), "u").tolist() == [[1.5]]


def test_what_is_no_number_is_refused_by_its_type() -> None:
    with pytest.raises(BadValues, match=r"the solution is a builtins.dict, which is no array of numbers"):
        real({"u": 1}, "the solution")
    with pytest.raises(BadValues, match=r"u is a builtins.list"):
        real([[1.0], [1.0, 2.0]], "u")
    with pytest.raises(BadValues, match="the solution has complex numbers: give real ones"):
        real([1j], "the solution")


def test_a_diverged_solver_is_named() -> None:
    with pytest.raises(BadValues, match="the solution has 2 of 3 values that are nan or infinite, so the solver div"):
        finite(np.array([1.0, np.nan, np.inf]), "the solution")


def test_the_array_is_a_copy() -> None:
    own = np.ones(3)
    taken = real(own, "u")
    own[:] = 2.0
    assert taken.tolist() == [1.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "values", [np.ma.masked_equal([1.0, 2.0], 2.0), ["1.5"], np.array(["2020-01-01"], dtype="M8[D]"), [10**400]]
)
def test_what_are_no_numbers_is_refused(values: object) -> None:
    with pytest.raises(BadValues):
        real(values, "u")
