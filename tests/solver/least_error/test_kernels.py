"""The loops of the objective and its cells: values against plain formulas, derivatives against differences."""

from __future__ import annotations

import math
from weakref import ref

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import kernels, lagrange
from equimesh.least_error import objective as module
from equimesh.least_error.cells import cells_of_grid, cells_of_mesh
from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Norm, Rule, Values
from equimesh.numerics.types import Array, IntArray
from equimesh.quality.elements import CellKind, basis
from equimesh.testing.geometries import disc
from solver.bent import RING, bent, objective_on, remainders, uniform

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


@pytest.mark.parametrize("cells", ["quad", "triangle"])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_degree_1_is_that_of_the_loops_for_degree_1(norm: Norm, cells: CellKind) -> None:
    mesh, rule = bent(GRID, 1), Rule(norm=norm, cells=cells)
    corners = em.Mesh(*mesh.reshape(2, *GRID.shape)).cells
    nodes, elements, element = Nodes(*mesh, corners.reshape(-1)), rule.elements(len(corners)), rule.element
    x, y = np.empty((2, element.weights.size, len(elements)))
    kernels.place_points(nodes, elements, element.shape, 0, x.reshape(-1), y.reshape(-1))
    nodal, at = NodalValues(*RING.evaluate(*mesh, order=1)), RING.evaluate(x, y, order=2)
    none = NodalValues(*np.empty((3, 0, len(elements))))
    plain, general = np.zeros((2, GRID.points, SUMS))
    one = basis(cells, 1, element)
    if norm == "l2":
        values = NodalValues(*at[:3])
        expected = kernels.value_errors(nodes, elements, element, nodal, values, plain)
        found = lagrange.value_errors(nodes, elements, element, one, nodal, none, values, general)
    else:
        expected = kernels.slope_errors(nodes, elements, element, nodal, Values(*at), plain)
        found = lagrange.slope_errors(nodes, elements, element, one, nodal, none, Values(*at), general)
    assert found[0] == pytest.approx(expected[0], rel=1e-13)
    assert np.abs(plain).max() > 1e-6
    assert general == pytest.approx(plain, rel=1e-11, abs=1e-13)


@pytest.mark.parametrize("first", [0, 3])
def test_biquadratic_cells_are_those_of_the_loop_for_all_degrees(first: int) -> None:
    mesh, rule = bent(GRID, 1), Rule(degree=2)
    corners = em.Mesh(*mesh.reshape(2, *GRID.shape)).cells
    nodes, elements, element = Nodes(*mesh, corners.reshape(-1)), rule.elements(len(corners))[first:], rule.element
    inner, points = (np.empty((2, len(shapes), len(elements))) for shapes in (rule.inner_places, element.shape))
    kernels.place_points(nodes, elements, rule.inner_places, 0, *inner.reshape(2, -1))
    kernels.place_points(nodes, elements, element.shape, 0, *points.reshape(2, -1))
    nodal, inside, at = (NodalValues(*RING.evaluate(*where, order=1)) for where in (mesh, inner, points))
    expected, found = np.zeros((2, GRID.points, SUMS))
    total, check = lagrange.value_errors(nodes, elements, element, rule.basis, nodal, inside, at, expected)
    span, functions = (first, len(corners)), rule.basis.value
    of_cells = lagrange.biquadratic_value_errors(nodes, span, element, functions, nodal, inside, at, found)
    assert of_cells == pytest.approx((total, check), rel=1e-12)
    assert np.abs(expected).max() > 1e-6
    assert found == pytest.approx(expected, rel=1e-10, abs=1e-14)


@pytest.mark.parametrize("degree", [2, 3, 4])
@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_polynomials_of_the_degree_have_no_error_on_any_mesh(norm: Norm, degree: int) -> None:
    # A polynomial of total degree p is one of degree p in s and in t on every bilinear cell.
    objective = objective_on(GRID, em.Expression(f"(x - 2*y + 0.3)**{degree}"), rule=Rule(norm=norm, degree=degree))
    assert objective.error(bent(GRID, 2)) < 1e-12
    assert objective.evaluate(bent(GRID, 2)) is None  # the error is rounding
    more = objective_on(GRID, em.Expression(f"(x - 2*y + 0.3)**{degree + 1}"), rule=Rule(norm=norm, degree=degree))
    assert more.error(bent(GRID, 2)) > 1e-6


@pytest.mark.parametrize("points", [200, 10_000])
def test_slopes_that_are_infinite_at_nodes_of_an_element_become_those_nearby(
    points: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_BLOCK_POINTS", points)  # several spans of cells, or one
    # Along x = 0 the slope is infinite at all nodes, those in the middles of edges too.
    rule = Rule(degree=2, points=4)
    objective, mesh = objective_on(GRID, em.Expression("sqrt(x)*(1 + y)"), rule=rule), bent(GRID, 3)
    here = objective.evaluate(mesh)
    assert np.isfinite(here.gradient).all()
    assert np.isfinite(here.blocks).all()
    along = np.zeros_like(mesh)
    inner = (mesh[0] > 0.3) & (mesh[0] < 0.9) & (mesh[1] > 0.0) & (mesh[1] < 1.0)
    along[:, inner] = np.random.default_rng(4).normal(size=(2, int(inner.sum())))

    def value(h: float) -> float:
        then = objective.evaluate(mesh + h * along)
        return then.value

    first, second = remainders(value, float(np.vdot(here.gradient, along)), 1e-3)
    assert first / second == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 3), (3, 4), (4, 5)])
def test_the_error_falls_with_the_order_of_the_degree(degree: int, order: int) -> None:
    wave, errors = em.Expression("sin(3*x)*cos(2*y)"), []
    for n in (9, 17):
        grid = em.Grid(n_xi=n, n_eta=n)
        errors.append(objective_on(grid, wave, rule=Rule(degree=degree, points=degree + 2)).error(uniform(grid)))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.1)


GRIDS = [em.Grid(n_xi=4, n_eta=4), em.Grid(n_xi=7, n_eta=5), em.Grid(n_xi=5, n_eta=12)]


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_cells_and_nodes_have_the_numbers_of_meshes(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    assert np.array_equal(cells.corners, em.Mesh.uniform(grid).cells)
    assert (cells.count, cells.nodes) == ((grid.n_xi - 1) * (grid.n_eta - 1), grid.points)


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_every_corner_is_a_place_of_its_node_exactly_once(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    assert sorted(cells.places) == list(range(4 * cells.count))
    for node in range(cells.nodes):
        places = cells.places[cells.starts[node] : cells.starts[node + 1]]
        assert (cells.corners.reshape(-1)[places] == node).all()


@pytest.mark.parametrize("size", [1, 5, 100])
def test_spans_of_a_group_have_no_common_node(size: int) -> None:
    cells = cells_of_grid((9, 8))
    groups = cells.apart(size)
    assert sorted(k for group in groups for span in group for k in range(*span)) == list(range(cells.count))
    assert len(groups) == {1: 4, 5: 3, 100: 1}[size]
    for group in groups:
        nodes = [np.unique(cells.corners[slice(*span)]) for span in group]
        assert len(np.unique(np.concatenate(nodes))) == sum(map(len, nodes))


def test_spans_that_all_have_one_node_in_common_are_groups_of_their_own() -> None:
    around = np.arange(1, 241).reshape(80, 3)
    star = np.column_stack([np.zeros(80, dtype=np.int64), around])  # as of a file whose cells are in no order
    cells = cells_of_mesh(star, np.ones((2, 241)), np.empty((0, 2), dtype=np.int64))
    assert cells.apart(1) == [[(k, k + 1)] for k in range(80)]


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_nodes_of_sides_stay_on_them_and_corners_stay(grid: em.Grid) -> None:
    s, t = uniform(grid)
    free = cells_of_grid(grid.shape).free
    assert np.array_equal(free[0] == 0, (s == 0) | (s == 1))
    assert np.array_equal(free[1] == 0, (t == 0) | (t == 1))
    assert set(np.unique(free)) == {0.0, 1.0}


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_triples_are_neighbours_in_a_line_and_every_inner_node_is_in_the_middle_of_two(grid: em.Grid) -> None:
    cells, mesh = cells_of_grid(grid.shape), uniform(grid)
    first, middle, last = mesh[:, cells.triples.T].transpose(1, 0, 2)
    assert np.abs(first + last - 2 * middle).max() < 1e-15
    assert np.abs(last - first).max(axis=0) == pytest.approx(
        np.where(last[0] > first[0], 2 / (grid.n_xi - 1), 2 / (grid.n_eta - 1))
    )
    s, t = mesh
    inner = ((s > 0) & (s < 1)).astype(int) + ((t > 0) & (t < 1))
    assert np.array_equal(np.bincount(cells.triples[:, 1], minlength=cells.nodes), inner)


@pytest.mark.parametrize("grid", GRIDS, ids=str)
def test_stiffness_is_the_diagonal_of_the_sum_of_squared_second_differences(grid: em.Grid) -> None:
    cells = cells_of_grid(grid.shape)
    differences = np.zeros((len(cells.triples), cells.nodes))
    for column, weight in enumerate((1.0, -2.0, 1.0)):
        differences[np.arange(len(cells.triples)), cells.triples[:, column]] += weight
    assert np.array_equal(cells.stiffness, np.diag(differences.T @ differences))


def test_the_cells_of_a_grid_are_kept() -> None:
    assert cells_of_grid((6, 9)) is cells_of_grid((6, 9))


def test_of_large_grids_only_the_last_is_kept() -> None:
    first = cells_of_grid((131, 129))
    assert cells_of_grid((131, 129)) is first
    forgotten = ref(first)
    del first
    cells_of_grid((129, 131))
    assert forgotten() is None


# The cells of any mesh of quadrilaterals: those of a grid are as before, and lines end at singular nodes.

OPEN, CLOSED = (False, False), (False, True)


def as_set(triples: IntArray) -> set[tuple[int, ...]]:
    return {min(tuple(row), tuple(row[::-1])) for row in triples.tolist()}


@pytest.mark.parametrize("closed", [OPEN, CLOSED], ids=str)
def test_on_a_grid_they_are_those_of_the_grid(closed: tuple[bool, bool]) -> None:
    grid = cells_of_grid((5, 7), closed)
    cells = cells_of_mesh(grid.corners, grid.free, grid.ties)
    assert np.array_equal(cells.starts, grid.starts)
    assert np.array_equal(cells.places, grid.places)
    assert as_set(cells.triples) == as_set(grid.triples)
    assert len(cells.triples) == len(grid.triples)
    assert np.array_equal(cells.stiffness, grid.stiffness)


def test_lines_end_at_nodes_of_three_cells() -> None:
    mesh = disc(300).mesh
    cells = cells_of_mesh(mesh.cells, np.ones((2, len(mesh.points))), mesh.ties)
    used, middle = np.bincount(mesh.cells.ravel()), np.bincount(cells.triples[:, 1], minlength=len(mesh.points))
    assert (used == 3).sum() == 4
    assert (middle[used == 3] == 0).all()
    assert (middle[used == 4] == 2).all()
    assert (middle[used == 2] == 1).all()
