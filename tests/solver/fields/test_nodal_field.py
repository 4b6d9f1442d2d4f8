"""Functions given at the nodes of a mesh: values, derivatives, and the way to the next mesh."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.errors import InputError, SamplesError
from equimesh.fields.mesh_map import MeshMap
from equimesh.fields.nodal_field import HermiteField, nodal_gradients
from equimesh.testing import check_field
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
    assert np.array_equal(u.evaluate(front.x, front.y)[0], u.values)
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
    with pytest.raises(InputError, match=r"folded.* xi first, as from numpy\.meshgrid"):
        em.NodalField(mesh=em.Mesh(mesh.y, mesh.x), values=np.zeros(mesh.x.shape))


# u by limited cubics on the edges of a mesh: order, linear functions, no overshoots.


RISING = em.Expression("exp(x + y/2) + x")


def field_of(u: em.Expression, mesh: em.Mesh) -> HermiteField:
    return HermiteField(mesh=mesh, values=u.evaluate(mesh.x, mesh.y)[0])


def test_values_are_of_order_3_and_gradients_of_order_2() -> None:
    errors = [largest(field_of(RISING, smooth_mesh(n)).evaluate(*ANYWHERE, order=1),
                      RISING.evaluate(*ANYWHERE, order=1)) for n in (17, 33, 65)]  # fmt: skip
    orders = np.log2(errors[0] / errors[2]) / 2.0
    assert np.all(orders > np.array([2.7, 1.7, 1.7])), orders
    assert np.all(errors[-1] < np.array([1e-5, 3e-3, 3e-3])), errors[-1]


def test_hermite_patches_are_exact_for_linear_functions(front: em.Mesh) -> None:
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


@pytest.mark.parametrize("shape", [(-1,), (2, -1)])
def test_values_do_not_depend_on_the_points_before(front: em.Mesh, shape: tuple[int, ...]) -> None:
    for mesh in (front, em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))):
        on_edges = np.stack([0.3 * mesh.x[1:] + 0.7 * mesh.x[:-1], 0.3 * mesh.y[1:] + 0.7 * mesh.y[:-1]])
        points = np.concatenate([on_edges.reshape(2, -1), np.stack(ANYWHERE)], axis=1)
        x, y = np.random.default_rng(5).permutation(points, axis=1).reshape(2, *shape)
        wanted = field_of(RISING, mesh).evaluate(x, y, order=2)
        for near in (1e-9, 0.03, 0.3):
            field = field_of(RISING, mesh)
            field.evaluate(x + near, y, order=2)
            for one, other in zip(field.evaluate(x, y, order=2), wanted, strict=True):
                assert one.tobytes() == other.tobytes()


def test_bad_values_and_folded_meshes_are_refused() -> None:
    mesh = em.Mesh.uniform(em.Grid(n_xi=5, n_eta=4))
    with pytest.raises(SamplesError, match=r"values has shape \(4, 5\).*transpose it"):
        HermiteField(mesh=mesh, values=np.ones((4, 5)))
    for flat in (np.ones(20), [1.0] * 20):
        with pytest.raises(SamplesError, match=r"a value at each node is needed, shape \(5, 4\), xi first; reshape it"):
            HermiteField(mesh=mesh, values=flat)
    with pytest.raises(SamplesError, match=r"values\[1\]\[2\] is NaN"):
        HermiteField(mesh=mesh, values=np.where(mesh.x * 0 + np.arange(20).reshape(5, 4) == 6, np.nan, 1.0))
    with pytest.raises(InputError, match="the mesh is folded"):
        HermiteField(mesh=em.Mesh(mesh.x[::-1].copy(), mesh.y), values=np.ones((5, 4)))
    assert repr(HermiteField(mesh=mesh, values=mesh.x)) == f"HermiteField({mesh.grid})"


# Gradients at the nodes, from differences along grid lines.


def test_gradients_are_of_order_2_also_at_the_sides() -> None:
    errors = []
    for n in (17, 33, 65):
        mesh = smooth_mesh(n)
        u, *exact = WAVY.evaluate(mesh.x, mesh.y, order=1)
        errors.append(largest(nodal_gradients(mesh.x, mesh.y, u), tuple(exact)))
    orders = np.log2(errors[1] / errors[2])
    assert np.all(orders > 1.6), orders
    assert np.all(errors[-1] < 0.02), errors[-1]


def test_a_parabola_has_exact_slopes_along_uneven_lines() -> None:
    x = np.array([0.0, 0.01, 0.05, 0.3, 1.0])
    nodes = np.meshgrid(x, np.linspace(0.0, 1.0, 4), indexing="ij")
    u_x, _ = nodal_gradients(*nodes, nodes[0] ** 2)
    assert np.abs(u_x - 2.0 * nodes[0]).max() < 1e-12


def test_cells_around_a_node_decide_where_its_lines_have_nearly_one_direction() -> None:
    s, t = np.meshgrid(np.linspace(0.0, 1.0, 9), np.linspace(0.0, 1.0, 9), indexing="ij")
    x, y = s + 200.0 * t, t  # every cell is a long thin parallelogram
    found = nodal_gradients(x, y, 2.0 * x + 5.0 * y)
    assert largest(found, (np.full((9, 9), 2.0), np.full((9, 9), 5.0))).max() < 1e-9


def test_noise_is_not_raised_where_both_lines_of_a_node_have_one_direction() -> None:
    def at(radius: float, degrees: float) -> tuple[float, float]:
        return radius * np.cos(np.radians(degrees)), radius * np.sin(np.radians(degrees))

    nodes = np.zeros((3, 3, 2))
    nodes[2, 1], nodes[1, 2], nodes[2, 2], nodes[0, 2], nodes[2, 0] = (1, 0), (0, 1), (1, 1), (-1, 1), (1, -1)
    nodes[0, 1], nodes[1, 0], nodes[0, 0] = at(1e-4, 225), at(1e-4, 225.0001), at(2e-4, 225.00005)
    x, y = np.ascontiguousarray(nodes[..., 0]), np.ascontiguousarray(nodes[..., 1])
    values = 2.0 * x + y
    values[0, 1] += 1e-8  # of the value at a node so near, this is a slope of 1e-4
    u_x, u_y = nodal_gradients(x, y, values)
    assert abs(u_x[1, 1] - 2.0) + abs(u_y[1, 1] - 1.0) < 1e-3
