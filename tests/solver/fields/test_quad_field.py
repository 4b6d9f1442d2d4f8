"""Values at the nodes of blocks as functions of x and y, and gradients from cubics on patches."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from block_cases import l_shape
from equimesh.fields.expression import Expression
from equimesh.fields.nodal_field import HermiteField
from equimesh.fields.quad_field import (
    MAX_TURNS,
    QuadField,
    along_lines,
    from_neighbours,
    mean_of_cells,
    patch_gradients,
    quad_gradients,
)
from equimesh.meshes.cell_edges import QuadLinks, links_of
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import lattice_of
from solver.fields.bent_meshes import smooth_mesh
from solver.meshes.quad_cases import bent, corner, disc, inner_points, merged, ring, strip


def wave(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth function."""
    return np.sin(2 * x + y) * np.exp(y / 2)


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("mesh", [corner(5), bent(disc(6), 0.03), ring(4)])
def test_linear_functions_are_exact(mesh: Mesh, limited: bool) -> None:
    x, y = inner_points(mesh).T
    found = QuadField(mesh=mesh, values=1 + 2 * mesh.x - 3 * mesh.y, limited=limited).evaluate(x, y, order=2)
    for part, wanted in zip(found, (1 + 2 * x - 3 * y, 2, -3, 0, 0, 0), strict=True):
        assert np.abs(part - wanted).max() < 1e-10


@pytest.mark.parametrize("make", [corner, disc, ring])
def test_the_error_falls_with_the_cube_of_the_spacing(make: type) -> None:
    errors = []
    for n in (8, 16, 32):
        mesh = make(n)
        x, y = inner_points(mesh, 2000).T
        errors.append(
            np.abs(
                QuadField(mesh=mesh, values=wave(mesh.x, mesh.y), limited=False).evaluate(x, y)[0] - wave(x, y)
            ).max()
        )
    assert errors[0] / errors[1] > 6
    assert errors[1] / errors[2] > 6


def test_derivatives_are_those_of_the_values() -> None:
    mesh, h = bent(disc(7), 0.03), 1e-5
    u = QuadField(mesh=mesh, values=wave(mesh.x, mesh.y))
    x, y = (0.8 * mesh.points[mesh.cells].mean(axis=1)).T
    _, u_x, u_y, u_xx, u_xy, u_yy = u.evaluate(x, y, order=2)
    for (dx, dy), first, (second, third) in (((h, 0), u_x, (u_xx, u_xy)), ((0, h), u_y, (u_xy, u_yy))):
        ahead, behind = u.evaluate(x + dx, y + dy, order=1), u.evaluate(x - dx, y - dy, order=1)
        slopes = [(one - other) / (2 * h) for one, other in zip(ahead, behind, strict=True)]
        # A few points lie within h of an edge.
        for found, wanted in zip(slopes, (first, second, third), strict=True):
            assert np.quantile(np.abs(found - wanted), 0.97) < 1e-6


def test_a_grid_has_the_same_function_inside() -> None:
    grid = smooth_mesh(40)  # lines turn by less than 0.1 at each node
    quads = Mesh(points=grid.points, cells=grid.cells, sides=grid.sides)
    values = np.tanh(9 * (grid.x - 0.5 * grid.y - 0.3))
    x, y = (grid.points[grid.cells].reshape(grid.x.shape[0] - 1, -1, 4, 2)[2:-2, 2:-2].mean(axis=2).reshape(-1, 2)).T
    one = HermiteField(mesh=grid, values=values).evaluate(x, y, order=2)
    other = QuadField(mesh=quads, values=values.reshape(-1)).evaluate(x, y, order=2)
    for part, same in zip(one, other, strict=True):
        assert np.abs(part - same).max() < 1e-9 * np.abs(part).max()


def test_a_step_does_not_overshoot_where_it_is_limited() -> None:
    mesh = bent(disc(10), 0.01)
    values = (mesh.x > 0.1).astype(float)
    x, y = inner_points(mesh, 2000).T
    limited, free = (QuadField(mesh=mesh, values=values, limited=k).evaluate(x, y)[0] for k in (True, False))
    assert -0.05 < limited.min() <= limited.max() < 1.05
    assert free.max() > 1.05


def test_u_goes_on_across_a_periodic_join() -> None:
    mesh = strip(16, 0.02, 0.01)
    u = QuadField(mesh=mesh, values=np.sin(2 * np.pi * mesh.x) + mesh.y)
    x, y = np.linspace(0.7, 1.3, 61), np.full(61, 0.45)
    for one, other in zip(u.evaluate(x, y, order=1), u.evaluate(x - 1.0, y, order=1), strict=True):
        assert np.abs(one - other).max() < 1e-9
    assert np.abs(u.evaluate(x, y)[0] - np.sin(2 * np.pi * x) - y).max() < 0.02


def test_points_outside_and_points_that_are_none() -> None:
    mesh = corner(6)
    u = QuadField(mesh=mesh, values=mesh.x)
    assert u.evaluate(np.array([[3.0], [-1.0]]), np.array([[0.5], [0.5]]))[0].tolist() == [[2.0], [0.0]]
    assert np.isnan(u.evaluate(np.array([np.nan]), np.array([0.0]), order=1)).all()
    assert "cells" in repr(u)


def test_values_that_do_not_fit_are_refused_with_their_place() -> None:
    mesh = corner(3)
    values = np.zeros(len(mesh.points))
    with pytest.raises(em.SamplesError, match="a value at each node is needed"):
        QuadField(mesh=mesh, values=values[:-1])
    values[4] = 1e300
    with pytest.raises(em.SamplesError, match=r"values\[4\] = 1e\+300"):
        QuadField(mesh=mesh, values=values)
    points = mesh.points.copy()
    points[4] = 9.0
    with pytest.raises(em.InputError, match="folded"):
        QuadField(mesh=mesh.moved(points), values=np.zeros(len(points)))


# Gradients at the nodes of meshes of blocks.


def arguments(mesh: Mesh) -> tuple[tuple[np.ndarray, np.ndarray], QuadLinks]:
    """The nodes and the links of a mesh."""
    return (mesh.x.copy(), mesh.y.copy()), links_of(mesh.cells, len(mesh.points))


@pytest.mark.parametrize("mesh", [corner(4), bent(disc(6), 0.03), ring(3), disc(1)])
def test_linear_functions_have_exact_gradients(mesh: Mesh) -> None:
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


def bent_nodes(n: int, squeeze: float = 1.0) -> Mesh:
    s, t = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    bump = 0.05 * np.sin(2 * np.pi * s) * np.sin(2 * np.pi * t)
    return Mesh(s + bump, squeeze * (t + bump))


@pytest.mark.parametrize(
    "mesh", [bent_nodes(7), bent_nodes(7, squeeze=1e-4), l_shape()], ids=["grid", "thin cells", "blocks"]
)
def test_cubics_are_exact_also_at_the_sides(mesh: Mesh) -> None:
    nodes = lattice_of(mesh)
    size = np.ptp(nodes.y)
    x, y = nodes.points.T
    u = x**3 - 2.0 * x * x * (y / size) + (y / size) ** 3 + x
    u_x, u_y = patch_gradients(nodes.points, nodes.cells, u)
    np.testing.assert_allclose(u_x, 3.0 * x * x - 4.0 * x * y / size + 1.0, atol=1e-8)
    np.testing.assert_allclose(size * u_y, -2.0 * x * x + 3.0 * (y / size) ** 2, atol=1e-8)


def test_errors_fall_with_the_third_power_in_gradients_and_the_fourth_in_values() -> None:
    u = Expression("sin(6*x)*cos(5*y)")
    x, y = np.random.default_rng(0).random((2, 500))
    errors = []
    for n in (9, 17, 33):
        nodes = lattice_of(bent_nodes(n))
        value, *slopes = u.evaluate(nodes.x, nodes.y, 1)
        found = patch_gradients(nodes.points, nodes.cells, value.ravel())
        of_slopes = max(float(np.abs(one - other.ravel()).max()) for one, other in zip(found, slopes, strict=True))
        field = HermiteField(mesh=nodes, values=value, fitted=True)
        errors.append((of_slopes, float(np.abs(field.evaluate(x, y)[0] - u.evaluate(x, y)[0]).max())))
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert rates[-1, 0] > 2.7
    assert rates[-1, 1] > 3.5


def test_blocks_have_the_function_of_the_grid_but_for_rounding() -> None:
    grid = lattice_of(bent_nodes(5))
    values = np.cos(4.0 * grid.x) * grid.y
    alone = HermiteField(mesh=grid, values=values, fitted=True)
    whole = Mesh(points=grid.points, cells=grid.cells, sides=grid.sides)
    field = QuadField(mesh=whole, values=values.ravel(), fitted=True, limited=False)
    x, y = np.random.default_rng(1).random((2, 50))
    for one, other in zip(alone.evaluate(x, y, 2), field.evaluate(x, y, 2), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
