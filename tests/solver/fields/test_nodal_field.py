"""Functions given at the nodes of a mesh: values, derivatives, and the way to the next mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh.fields.mesh_map import MeshMap
from solver.fields.bent_meshes import ANYWHERE, largest, smooth_mesh

WAVY = em.Expression("sin(3*x + y)*exp(y/2)")


def test_values_are_of_order_4_gradients_of_3_and_second_derivatives_of_2() -> None:
    errors = []
    for n in (17, 33, 65):
        mesh = smooth_mesh(n)
        field = em.NodalField(mesh=mesh, values=WAVY.evaluate(mesh.x, mesh.y)[0])
        errors.append(largest(field.evaluate(*ANYWHERE, order=2), WAVY.evaluate(*ANYWHERE, order=2)))
    orders = np.log2(errors[1] / errors[2])
    assert np.all(orders > np.array([3.7, 2.7, 2.7, 1.7, 1.7, 1.7])), orders
    assert np.all(errors[-1] < np.array([1e-5, 2e-3, 2e-3, 0.3, 0.3, 0.3])), errors[-1]


def test_linear_functions_are_exact_on_every_mesh(front: em.Mesh) -> None:
    field = em.NodalField(mesh=front, values=2.0 * front.x - front.y + 1.0)
    x, y = ANYWHERE
    exact = (2.0 * x - y + 1.0, np.full_like(x, 2.0), np.full_like(x, -1.0))
    assert largest(field.evaluate(x, y, order=1), exact).max() < 1e-11
    moved = em.transfer(front, {"u": 2.0 * front.x - front.y + 1.0}, smooth_mesh(9))["u"]
    assert np.abs(moved - (2.0 * smooth_mesh(9).x - smooth_mesh(9).y + 1.0)).max() < 1e-12


def test_the_cells_take_over_where_the_spline_cannot_be_inverted() -> None:
    x = np.array([0.0, 0.001, 0.002, 0.9, 0.901, 0.902, 1.0])  # a spline through these goes back and forth
    mesh = em.Mesh(*np.meshgrid(x, x, indexing="ij"))
    field = em.NodalField(mesh=mesh, values=3.0 * mesh.x + mesh.y)
    inside = 0.0015 + 0.9 * ANYWHERE
    assert not MeshMap.of(mesh).locate(*inside).smooth.all()
    exact = (3.0 * inside[0] + inside[1], np.full(500, 3.0), np.full(500, 1.0))
    assert largest(field.evaluate(*inside, order=1), exact).max() < 1e-6


def test_outside_the_nearest_point_of_the_side_is_taken() -> None:
    mesh = smooth_mesh(17)
    field = em.NodalField(mesh=mesh, values=WAVY.evaluate(mesh.x, mesh.y)[0])
    there, nearest = (np.array([-0.2, 0.4, 1.3]), np.array([0.3, 1.1, -0.5])), ([0.0, 0.4, 1.0], [0.3, 1.0, 0.0])
    assert largest(field.evaluate(*there), field.evaluate(*map(np.array, nearest))).max() < 1e-12
    assert np.isnan(field.evaluate(np.array([np.nan]), np.array([0.5]), order=1)).all()


def test_a_field_is_carried_to_the_next_mesh_at_order_4() -> None:
    errors = []
    for n in (17, 33, 65):
        old, new = smooth_mesh(n), smooth_mesh(n, depth=0.05)
        moved = em.transfer(old, {"u": WAVY.evaluate(old.x, old.y)[0], "one": np.ones(old.x.shape)}, new)
        assert np.abs(moved["one"] - 1.0).max() < 1e-13
        errors.append(np.abs(moved["u"] - WAVY.evaluate(new.x, new.y)[0]).max())
    assert np.log2(errors[1] / errors[2]) > 3.7
    assert errors[-1] < 1e-5


def test_a_mesh_follows_values_at_its_own_nodes(front: em.Mesh) -> None:
    moved = em.Expression("tanh(40*(x + y/2 - 0.76))")
    grid = em.Grid(n_xi=33, n_eta=33)
    u = em.NodalField(mesh=front, values=moved.evaluate(front.x, front.y)[0])
    by_nodes = em.solve(em.Problem(monitor=em.ArcLength(u=u), grid=grid), initial=front)
    by_formula = em.solve(em.Problem(monitor=em.ArcLength(u=moved), grid=grid))
    assert np.abs(by_nodes.mesh.x - by_formula.mesh.x).max() < 2e-3
    assert np.abs(by_nodes.mesh.x - front.x).max() > 5e-3


def test_what_cannot_be_a_function_is_refused() -> None:
    mesh = smooth_mesh(9)
    with pytest.raises(SamplesError, match=r"u has shape \(12, 9\).*transpose"):
        em.transfer(mesh, {"u": np.zeros((12, 9))}, mesh)
    bad = np.zeros(mesh.x.shape)
    bad[2, 3] = np.nan
    with pytest.raises(SamplesError, match=r"values\[2\]\[3\]"):
        em.NodalField(mesh=mesh, values=bad)
    with pytest.raises(InputError, match="folded"):
        em.NodalField(mesh=em.Mesh(mesh.y, mesh.x), values=np.zeros(mesh.x.shape))
