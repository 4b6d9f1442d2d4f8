"""Gradients at the nodes, from differences along grid lines."""

from __future__ import annotations

import numpy as np

import equimesh as em
from equimesh.fields.nodal_field import nodal_gradients
from solver.fields.bent_meshes import largest, smooth_mesh

WAVY = em.Expression("sin(3*x + y)*exp(y/2)")


def test_gradients_are_of_order_2_also_at_the_sides() -> None:
    errors = []
    for n in (17, 33, 65):
        mesh = smooth_mesh(n)
        u, *exact = WAVY.evaluate(mesh.x, mesh.y, order=1)
        errors.append(largest(nodal_gradients(mesh.x, mesh.y, u), tuple(exact)))
    orders = np.log2(errors[1] / errors[2])
    assert np.all(orders > 1.6), orders
    assert np.all(errors[-1] < 0.02), errors[-1]


def test_linear_functions_have_exact_gradients_where_spacings_jump() -> None:
    x = np.array([0.0, 0.001, 0.002, 0.9, 0.901, 0.902, 1.0])
    nodes = np.meshgrid(x, x, indexing="ij")
    found = nodal_gradients(*nodes, 3.0 * nodes[0] - 2.0 * nodes[1])
    assert largest(found, (np.full((7, 7), 3.0), np.full((7, 7), -2.0))).max() < 1e-11


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
