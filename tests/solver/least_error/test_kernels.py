"""The loops of the objective: values against plain formulas, derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import kernels
from equimesh.least_error.cells import cells_of_grid
from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Rule, Values
from equimesh.numerics.types import Array
from solver.bent import RING, bent, remainders, uniform

GRID = em.Grid(n_xi=6, n_eta=5)
CELLS = cells_of_grid(GRID.shape)
RULES = {
    "quad l2": Rule(points=3),
    "quad h1": Rule(points=3, norm="h1"),
    "triangle l2": Rule(cells="triangle"),
    "triangle h1": Rule(cells="triangle", norm="h1"),
}


def nodes_of(mesh: Array) -> Nodes:
    return Nodes(mesh[0].copy(), mesh[1].copy(), CELLS.corners.reshape(-1))


def squared_error(rule: Rule, mesh: Array, sums: Array | None = None) -> float:
    """The integral over all cells; the nodes may be anywhere."""
    nodes, elements, element = nodes_of(mesh), rule.elements(CELLS.count), rule.element
    sums = np.zeros((CELLS.nodes, SUMS)) if sums is None else sums
    x, y = np.empty((2, element.weights.size, len(elements)))
    kernels.place_points(nodes, elements, element.shape, 0, x.reshape(-1), y.reshape(-1))
    nodal = NodalValues(*RING.evaluate(nodes.x, nodes.y, order=1))
    if rule.norm == "h1":
        return kernels.slope_errors(nodes, elements, element, nodal, Values(*RING.evaluate(x, y, order=2)), sums)[0]
    at = NodalValues(*RING.evaluate(x, y, order=1))
    if rule.cells == "quad":
        return kernels.quad_value_errors(nodes, (0, CELLS.count), element, nodal, at, sums)[0]
    return kernels.value_errors(nodes, elements, element, nodal, at, sums)[0]


def test_cells_at_once_are_those_one_by_one() -> None:
    rule, mesh = RULES["quad l2"], bent(GRID, 1)
    nodes, elements = nodes_of(mesh), rule.elements(CELLS.count)
    x, y = np.empty((2, rule.element.weights.size, len(elements)))
    kernels.place_points(nodes, elements, rule.element.shape, 0, x.reshape(-1), y.reshape(-1))
    nodal, at = NodalValues(*RING.evaluate(*mesh, order=1)), NodalValues(*RING.evaluate(x, y, order=1))
    one, other = np.zeros((2, CELLS.nodes, SUMS))
    square, check = kernels.value_errors(nodes, elements, rule.element, nodal, at, one)
    assert kernels.quad_value_errors(nodes, (0, CELLS.count), rule.element, nodal, at, other)[0] == pytest.approx(
        square
    )
    assert other == pytest.approx(one, rel=1e-11, abs=1e-13)
    assert np.isfinite(check)
    at.u_y[3, 19] = np.inf
    for found in (
        kernels.value_errors(nodes, elements, rule.element, nodal, at, one),
        kernels.quad_value_errors(nodes, (0, CELLS.count), rule.element, nodal, at, one),
    ):
        assert not np.isfinite(found[1])


@pytest.mark.parametrize("name", RULES)
def test_squared_errors_are_those_of_plain_sums(name: str) -> None:
    rule, mesh, total = RULES[name], bent(GRID, 1), 0.0
    shape, along_s, along_t, weights = rule.element
    for corners in nodes_of(mesh).corners[rule.elements(CELLS.count)]:
        at = mesh[:, corners]
        u = RING.evaluate(*at)[0]
        for q in range(weights.size):
            x, y = at @ shape[q]
            jacobian = np.stack([at @ along_s[q], at @ along_t[q]], axis=1)
            det = np.linalg.det(jacobian)
            value, u_x, u_y = (part[0] for part in RING.evaluate(np.array([x]), np.array([y]), order=1))
            if rule.norm == "l2":
                total += weights[q] * det * (u @ shape[q] - value) ** 2
            else:
                slopes = np.linalg.solve(jacobian.T, [u @ along_s[q], u @ along_t[q]])
                total += weights[q] * det * ((slopes - [u_x, u_y]) ** 2).sum()
    assert squared_error(rule, mesh) == pytest.approx(total, rel=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", RULES)
def test_the_taylor_remainder_of_squared_errors_falls_at_second_order(name: str, seed: int) -> None:
    rule, mesh = RULES[name], bent(GRID, seed)
    sums = np.zeros((CELLS.nodes, SUMS))
    squared_error(rule, mesh, sums)
    gradient = sums.T[:2].copy()
    rng = np.random.default_rng(seed)
    for single in range(4):  # first all nodes, then single ones
        direction = rng.normal(size=mesh.shape)
        if single:
            direction *= np.arange(CELLS.nodes) == rng.integers(CELLS.nodes)
        slope = float(np.vdot(gradient, direction))
        first, second = remainders(lambda h, d=direction: squared_error(rule, mesh + h * d), slope, 1e-4)
        assert first / second == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("name", RULES)
def test_second_derivatives_of_squared_errors_are_positive_semidefinite(name: str) -> None:
    sums = np.zeros((CELLS.nodes, SUMS))
    squared_error(RULES[name], bent(GRID, 4, share=0.4), sums)
    a, b, d = sums[:, 2:].T
    size = np.maximum(a, d).max()
    assert (a >= 0).all()
    assert (d >= 0).all()
    assert (a * d - b * b >= -1e-14 * size**2).all()


def test_second_derivatives_of_squared_values_are_those_of_gauss_and_newton() -> None:
    # 2 sum of w J (N d)(N d)^T, with d the difference of the gradients of u at the corner and at the point.
    rule, mesh = RULES["quad l2"], bent(GRID, 5)
    sums = np.zeros((CELLS.nodes, SUMS))
    squared_error(rule, mesh, sums)
    shape, along_s, along_t, weights = rule.element
    at = mesh[:, CELLS.corners[0]]  # its first corner is that of no other cell
    points = at @ shape.T
    differences = np.stack(RING.evaluate(*at, order=1)[1:])[:, 0, None] - np.stack(RING.evaluate(*points, order=1)[1:])
    det = (at[0] @ along_s.T) * (at[1] @ along_t.T) - (at[0] @ along_t.T) * (at[1] @ along_s.T)
    block = 2.0 * (weights * det * shape[:, 0] ** 2 * differences) @ differences.T
    assert sums[0, 2:] == pytest.approx([block[0, 0], block[0, 1], block[1, 1]], rel=1e-12)


def distortion(mesh: Array, start: Array, sums: Array | None = None) -> float:
    sums = np.zeros((CELLS.nodes, SUMS)) if sums is None else sums
    return kernels.distortions(nodes_of(mesh), nodes_of(start), (0, CELLS.count), 1.0, sums)


def test_distortion_is_that_of_the_formula_and_nothing_for_similar_cells() -> None:
    start, mesh, total = bent(GRID, 6), bent(GRID, 7), 0.0
    for corners in CELLS.corners:
        for k in range(4):
            edges = [q[:, corners[[(k + 1) % 4, k - 1]]] - q[:, corners[[k]]] for q in (mesh, start)]
            matrix = edges[0] @ np.linalg.inv(edges[1])
            r = (matrix**2).sum() / (2 * np.linalg.det(matrix))
            total += (r**2 - 1) / 2
    assert distortion(mesh, start) == pytest.approx(total, rel=1e-12)
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    assert distortion(7.0 * turn @ start + 2.0, start) == pytest.approx(0.0, abs=1e-11)
    assert distortion(mesh, mesh) == pytest.approx(0.0, abs=1e-12)


def test_the_smallest_share_is_not_positive_where_a_corner_is_folded_or_not_a_number() -> None:
    start = uniform(GRID)
    for wrong in (start[:, CELLS.corners[8, 2]] + 0.3, np.nan, np.inf):
        mesh = start.copy()
        mesh[:, CELLS.corners[8, 0]] = wrong
        assert not kernels.smallest_share(nodes_of(mesh), nodes_of(start)) > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_the_taylor_remainder_of_distortion_falls_at_second_order(seed: int) -> None:
    start, mesh = bent(GRID, seed + 10), bent(GRID, seed)
    sums = np.zeros((CELLS.nodes, SUMS))
    distortion(mesh, start, sums)
    direction = np.random.default_rng(seed).normal(size=mesh.shape)
    slope = float(np.vdot(sums.T[:2].copy(), direction))
    first, second = remainders(lambda h: distortion(mesh + h * direction, start), slope, 1e-4)
    assert first / second == pytest.approx(4.0, abs=0.4)


def test_second_derivatives_of_distortion_are_positive_definite() -> None:
    sums = np.zeros((CELLS.nodes, SUMS))
    distortion(bent(GRID, 3, share=0.4), uniform(GRID), sums)
    a, b, d = sums.T[2:]
    assert (a > 0).all()
    assert (a * d > b * b).all()


def test_the_smallest_share_is_that_of_the_corner_jacobians() -> None:
    start, mesh = bent(GRID, 8), bent(GRID, 9, share=0.45)
    jacobians = [em.Mesh(*q.reshape(2, *GRID.shape)).corner_jacobians() for q in (mesh, start)]
    assert kernels.smallest_share(nodes_of(mesh), nodes_of(start)) == pytest.approx(
        (jacobians[0] / jacobians[1]).min(), rel=1e-12
    )


def test_bends_are_half_the_squared_second_differences_with_their_derivatives() -> None:
    moves, out = np.random.default_rng(2).normal(size=CELLS.nodes), np.zeros(CELLS.nodes)
    value = kernels.bends(moves, CELLS.triples, out)
    table = moves.reshape(GRID.shape)
    expected = 0.5 * sum((np.diff(table, 2, axis=axis) ** 2).sum() for axis in (0, 1))
    assert value == pytest.approx(expected, rel=1e-13)
    assert np.vdot(out, moves) == pytest.approx(2.0 * value, rel=1e-13)  # a quadratic form
    one = np.eye(CELLS.nodes)[7]
    assert out[7] == pytest.approx(
        0.5 * (kernels.bends(moves + one, CELLS.triples, out) - kernels.bends(moves - one, CELLS.triples, out)),
        rel=1e-12,
    )


def test_points_are_placed_by_the_shape_functions() -> None:
    mesh, rule = bent(GRID, 2), RULES["triangle l2"]
    elements = rule.elements(CELLS.count)
    x, y = np.empty((2, 6, len(elements)))
    kernels.place_points(nodes_of(mesh), elements, rule.element.shape, 0, x.reshape(-1), y.reshape(-1))
    expected = mesh[:, CELLS.corners.reshape(-1)[elements]] @ rule.element.shape.T
    assert np.stack([x, y]) == pytest.approx(expected.transpose(0, 2, 1), rel=1e-14)
