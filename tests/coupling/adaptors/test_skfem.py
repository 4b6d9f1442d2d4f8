"""scikit-fem: the mesh with its sides, and vectors of degrees of freedom."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import skfem

from block_cases import l_shape
from equimesh import Mesh
from equimesh_coupling import BadValues, MeshParts, element_points, element_values, node_values
from equimesh_coupling.adaptors.skfem import mesh_of


def test_nodes_cells_and_sides_are_those_of_the_mesh(parts: MeshParts) -> None:
    mesh = mesh_of(parts)
    assert np.array_equal(mesh.p.T, parts.points)
    assert np.array_equal(np.sort(mesh.t.T), np.sort(parts.cells))
    assert mesh.is_valid()
    assert {*mesh.boundaries} == {*parts.sides}
    for side, edges in parts.sides.items():
        found = mesh.facets[:, mesh.boundaries[side]].T
        assert {*map(frozenset, found.tolist())} == {*map(frozenset, edges.tolist())}


def test_a_mesh_of_the_solver_goes_there_with_both_kinds_of_cells(mesh: Mesh) -> None:
    assert isinstance(mesh.to_skfem(), skfem.MeshQuad)
    assert isinstance(mesh.to_skfem(cells="triangle"), skfem.MeshTri)


@pytest.mark.parametrize("order", [1, 2])
def test_solutions_come_back_in_the_order_of_the_nodes(order: int, parts: MeshParts) -> None:
    kinds = (skfem.ElementTriP1, skfem.ElementTriP2), (skfem.ElementQuad1, skfem.ElementQuad2)
    basis = skfem.Basis(mesh_of(parts), kinds[not parts.is_triangular][order - 1]())
    vector = basis.project(lambda x: x[0] + 2 * x[1])
    expected = (parts.points @ [1.0, 2.0]).reshape(parts.shape)
    assert np.allclose(node_values((basis, vector), parts), expected)


def test_other_elements_and_lengths_are_refused(quads: MeshParts) -> None:
    mesh = mesh_of(quads)
    constant = skfem.Basis(mesh, skfem.ElementQuad0())
    with pytest.raises(BadValues, match="take a scalar Lagrange element on this mesh"):
        node_values((constant, constant.zeros()), quads)
    bilinear = skfem.Basis(mesh, skfem.ElementQuad1())
    with pytest.raises(BadValues, match="the vector of scikit-fem has 3 entries, and its basis 35 degrees of freedom"):
        node_values((bilinear, np.ones(3)), quads)


def test_blocks_keep_their_sides_and_nodes() -> None:
    mesh = l_shape()
    for cells in ("quad", "triangle"):
        found = mesh.to_skfem(cells=cells)
        assert np.array_equal(found.p.T, mesh.points)
        assert {name: len(facets) for name, facets in found.boundaries.items()} == {"inlet": 8, "outlet": 4, "wall": 20}
        assert found.is_valid()
    basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1())
    assert node_values((basis, basis.project(lambda x: x[0] - x[1])), mesh) == pytest.approx(mesh.x - mesh.y)


def test_the_degree_is_that_of_the_element(parts: MeshParts) -> None:
    mesh = mesh_of(parts)
    quadratic = skfem.ElementTriP2() if parts.is_triangular else skfem.ElementQuad2()
    basis = skfem.Basis(mesh, quadratic)
    field = basis, basis.project(lambda x: x[0] ** 2 + 2 * x[1])
    found = element_values(field, parts)
    assert found[1:] == (2, "triangle" if parts.is_triangular else "quad")
    x, y = element_points(parts, *found[1:]).T
    assert np.allclose(found.values.ravel(), x**2 + 2 * y)
    assert element_values(field, parts, 1).values.shape == (7, 5)
    with pytest.raises(BadValues, match=f"one on {'tri' if parts.is_triangular else 'quadri'}.*, and cells = "):
        element_values(field, parts, cells="quad" if parts.is_triangular else "triangle")


@pytest.mark.parametrize(("cells", "element"), [("quad", skfem.ElementQuad2), ("triangle", skfem.ElementTriP2)])
def test_quadratic_values_on_blocks(cells: Any, element: Any) -> None:
    mesh = l_shape()
    basis = skfem.Basis(mesh.to_skfem(cells=cells), element())
    found = element_values((basis, basis.project(lambda x: x[0] * x[1])), mesh)
    assert np.allclose(found.values, element_points(mesh, 2, cells).prod(axis=1))


def test_elements_of_other_degrees_on_triangles_are_named(parts: MeshParts) -> None:
    basis = skfem.Basis(mesh_of(parts.mesh_parts("triangle")), skfem.ElementTriP3())
    with pytest.raises(BadValues, match=r"whose degree 2 can be seen: .* on the triangles .*mesh, 2, .triangle"):
        element_values((basis, basis.zeros()), parts, 2, "triangle")
