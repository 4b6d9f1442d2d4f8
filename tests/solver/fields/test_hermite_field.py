"""u by limited cubics on the edges of a mesh: order, linear functions, no overshoots."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh.fields.nodal_field import HermiteField
from equimesh.testing import check_field
from solver.fields.bent_meshes import ANYWHERE, largest, smooth_mesh

RISING = em.Expression("exp(x + y/2) + x")


def field_of(u: em.Expression, mesh: em.Mesh) -> HermiteField:
    return HermiteField(mesh=mesh, values=u.evaluate(mesh.x, mesh.y)[0])


def test_values_are_of_order_3_and_gradients_of_order_2() -> None:
    errors = [largest(field_of(RISING, smooth_mesh(n)).evaluate(*ANYWHERE, order=1),
                      RISING.evaluate(*ANYWHERE, order=1)) for n in (17, 33, 65)]  # fmt: skip
    orders = np.log2(errors[0] / errors[2]) / 2.0
    assert np.all(orders > np.array([2.7, 1.7, 1.7])), orders
    assert np.all(errors[-1] < np.array([1e-5, 3e-3, 3e-3])), errors[-1]


def test_linear_functions_are_exact_on_every_mesh(front: em.Mesh) -> None:
    x, y = ANYWHERE
    exact = (2.0 * x - y + 1.0, np.full(500, 2.0), np.full(500, -1.0), *np.zeros((3, 500)))
    uneven = np.array([0.0, 0.001, 0.002, 0.9, 0.901, 0.902, 1.0])
    for mesh in (front, smooth_mesh(9), em.Mesh(*np.meshgrid(uneven, uneven, indexing="ij"))):
        found = HermiteField(mesh=mesh, values=2.0 * mesh.x - mesh.y + 1.0).evaluate(x, y, order=2)
        assert largest(found[:3], exact[:3]).max() < 1e-9
        assert largest(found[3:], exact[3:]).max() < 1e-5


def test_it_is_a_field() -> None:
    check_field(field_of(RISING, smooth_mesh(3)))


def test_layers_thinner_than_a_cell_do_not_overshoot() -> None:
    mesh = smooth_mesh(17)
    steep = em.Expression("tanh(500*(x + y/2 - 0.75))")
    field = field_of(steep, mesh)
    share = np.linspace(0.0, 1.0, 33)[:, None, None]
    for first, second in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        x, y = ((1.0 - share) * q[first] + share * q[second] for q in (mesh.x, mesh.y))
        along = field.evaluate(x, y)[0]
        low, high = (pick(field.values[first], field.values[second]) for pick in (np.minimum, np.maximum))
        assert np.all(along >= low - 1e-7)
        assert np.all(along <= high + 1e-7)
    inside = field.evaluate(*ANYWHERE)[0]
    assert np.abs(inside).max() < 1.2
    assert np.abs(em.NodalField(mesh=mesh, values=field.values).evaluate(x, y)[0]).max() > 1.02  # a spline does


def test_outside_a_point_of_the_side_is_taken() -> None:
    field = field_of(RISING, em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17)))
    there, nearest = (np.array([-0.2, 0.4, 1.3]), np.array([0.3, 1.1, -0.5])), ([0.0, 0.4, 1.0], [0.3, 1.0, 0.0])
    assert largest(field.evaluate(*there), field.evaluate(*map(np.array, nearest))).max() < 1e-12
    assert np.isnan(field.evaluate(np.array([np.nan]), np.array([0.5]), order=1)).all()


def test_bad_values_and_folded_meshes_are_refused() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    with pytest.raises(SamplesError, match=r"values has shape \(4, 5\).*transpose it"):
        HermiteField(mesh=mesh, values=np.ones((4, 5)))
    with pytest.raises(SamplesError, match=r"values\[1\]\[2\] is NaN"):
        HermiteField(mesh=mesh, values=np.where(mesh.x * 0 + np.arange(20).reshape(5, 4) == 6, np.nan, 1.0))
    with pytest.raises(InputError, match="the mesh is folded"):
        HermiteField(mesh=em.Mesh(mesh.x[::-1], mesh.y), values=np.ones((5, 4)))
    assert repr(HermiteField(mesh=mesh, values=mesh.x)) == f"HermiteField({mesh.grid})"
