"""Gradients from cubics that are fitted on patches, and the functions through values that have them."""

from __future__ import annotations

import numpy as np
import pytest

from block_cases import l_shape
from equimesh.fields.expression import Expression
from equimesh.fields.nodal_field import HermiteField
from equimesh.fields.patch_gradients import patch_gradients
from equimesh.fields.quad_field import QuadField
from equimesh.meshes.mesh import Mesh
from equimesh.meshes.second_order import lattice_of


def bent(n: int, squeeze: float = 1.0) -> Mesh:
    s, t = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij")
    bump = 0.05 * np.sin(2 * np.pi * s) * np.sin(2 * np.pi * t)
    return Mesh(s + bump, squeeze * (t + bump))


@pytest.mark.parametrize("mesh", [bent(7), bent(7, squeeze=1e-4), l_shape()], ids=["grid", "thin cells", "blocks"])
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
        nodes = lattice_of(bent(n))
        value, *slopes = u.evaluate(nodes.x, nodes.y, 1)
        found = patch_gradients(nodes.points, nodes.cells, value.ravel())
        of_slopes = max(float(np.abs(one - other.ravel()).max()) for one, other in zip(found, slopes, strict=True))
        field = HermiteField(mesh=nodes, values=value, fitted=True)
        errors.append((of_slopes, float(np.abs(field.evaluate(x, y)[0] - u.evaluate(x, y)[0]).max())))
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert rates[-1, 0] > 2.7
    assert rates[-1, 1] > 3.5


def test_blocks_have_the_function_of_the_grid_but_for_rounding() -> None:
    grid = lattice_of(bent(5))
    values = np.cos(4.0 * grid.x) * grid.y
    alone = HermiteField(mesh=grid, values=values, fitted=True)
    whole = Mesh(points=grid.points, cells=grid.cells, sides=grid.sides)
    field = QuadField(mesh=whole, values=values.ravel(), fitted=True, limited=False)
    x, y = np.random.default_rng(1).random((2, 50))
    for one, other in zip(alone.evaluate(x, y, 2), field.evaluate(x, y, 2), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-7)
