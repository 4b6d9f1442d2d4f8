"""The nodes of elements of degree 2, and values that come from other places in any order."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import l_shape
from equimesh import Mesh
from equimesh.meshes.second_order import SecondOrderMesh, lattice_of
from equimesh_coupling import BadValues, MeshParts, element_points
from equimesh_coupling.elements import PlacedValues, at_elements, element_shape


def test_nodes_of_a_grid_are_those_of_its_lattice(mesh: Mesh, parts: MeshParts) -> None:
    assert element_shape(parts, 1) == (7, 5)
    assert element_shape(parts, 2) == (13, 9)
    assert np.array_equal(element_points(parts, 1), mesh.points)
    np.testing.assert_allclose(element_points(parts, 2), lattice_of(mesh).points, atol=1e-15)


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
