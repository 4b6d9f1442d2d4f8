"""Gradients at the nodes of meshes of blocks."""

from __future__ import annotations

import numpy as np
import pytest

from equimesh.fields.quad_field import MAX_TURNS, along_lines, from_neighbours, mean_of_cells, quad_gradients
from equimesh.meshes.cell_edges import QuadLinks, links_of
from equimesh.meshes.quad_mesh import QuadMesh
from solver.meshes.quad_cases import bent, corner, disc, merged, ring


def arguments(mesh: QuadMesh) -> tuple[tuple[np.ndarray, np.ndarray], QuadLinks]:
    """The nodes and the links of a mesh."""
    return (mesh.x.copy(), mesh.y.copy()), links_of(mesh.cells, len(mesh.points))


@pytest.mark.parametrize("mesh", [corner(4), bent(disc(6), 0.03), ring(3), disc(1)])
def test_linear_functions_have_exact_gradients(mesh: QuadMesh) -> None:
    u_x, u_y = quad_gradients(*arguments(mesh), 1 + 2 * mesh.x - 3 * mesh.y)
    assert max(np.abs(u_x - 2).max(), np.abs(u_y + 3).max()) < 1e-12


@pytest.mark.parametrize("make", [corner, disc, ring])
def test_gradients_are_of_second_order_at_every_node(make: type) -> None:
    """Also where three cells meet, at kinks of the lines, and at the boundary."""
    errors = []
    for n in (8, 16, 32):
        mesh = make(n)
        u_x, u_y = quad_gradients(*arguments(mesh), np.sin(2 * mesh.x + mesh.y))
        slope = np.cos(2 * mesh.x + mesh.y)
        errors.append(max(np.abs(u_x - 2 * slope).max(), np.abs(u_y - slope).max()))
    assert errors[0] / errors[1] > 2.8
    assert errors[1] / errors[2] > 2.8


def test_quadratic_functions_are_exact_where_the_blocks_meet_in_kinks() -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 7), indexing="ij")
    kinked = merged([(x, y + 0.5 * x), (x + 1.0, y + 0.5 - 0.5 * x)])
    u_x, u_y = quad_gradients(*arguments(kinked), kinked.x**2 + kinked.x * kinked.y)
    inner = (np.abs(kinked.x - 1.0) < 0.01) & (kinked.y > 0.6) & (kinked.y < 1.4)
    assert inner.sum() == 5
    assert np.abs(u_x - 2 * kinked.x - kinked.y)[inner].max() < 1e-12
    assert np.abs(u_y - kinked.x)[inner].max() < 1e-12


def test_each_part_fills_in_what_is_missing_alone() -> None:
    mesh = disc(4)
    nodes, links = arguments(mesh)
    values, gradients = mesh.x.copy(), np.full((2, len(mesh.points)), 7.0)
    known = np.zeros(len(mesh.points), dtype=bool)
    along_lines(nodes, links, values, np.cos(MAX_TURNS[0]), (gradients, known))
    first = known.copy()
    assert 0 < first.sum() < first.size
    assert np.all(gradients[:, ~first] == 7.0)
    assert from_neighbours(nodes, links, values, np.cos(MAX_TURNS[0]), (gradients, known)) == (known & ~first).sum() > 0
    rest = ~known
    mean_of_cells(nodes, links, values, gradients, known)
    assert rest.any()
    assert np.abs(gradients - np.array([[1.0], [0.0]])).max() < 1e-12


def test_a_gradient_is_not_fitted_to_slopes_that_are_nearly_along_one_line() -> None:
    """They say nothing of the slope across: their errors would be many times as large there."""
    x = np.array([[-1.0, -1.0, -1.0], [0.1, 0.0, 0.1], [1.0, 1.0, 1.0]])
    y = np.array([[-1.6, -0.6, 0.4], [-1.0, 0.0, 1.0], [-1.6, -0.6, 0.4]])
    mesh = merged([(x, y)])
    nodes, links = arguments(mesh)
    u = np.tanh(mesh.x + mesh.y / 2)
    gradients, known = np.stack([1.0 - u**2, 0.5 * (1.0 - u**2)]), mesh.x == 0.1
    assert known.sum() == 2
    from_neighbours(nodes, links, u, np.cos(MAX_TURNS[1]), (gradients, known))
    assert not known[(mesh.x == 0.0) & (mesh.y == 0.0)].any()
    u_x, _ = quad_gradients(nodes, links, u)
    assert 0.3 < u_x[(mesh.x == 0.0) & (mesh.y == 0.0)].item() < 1.0
