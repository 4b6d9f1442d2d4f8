"""Gains of elements of each degree: against errors by many points, and on meshes where they are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.domains.domain import map_mesh
from equimesh.meshes.mesh_data import MeshData
from equimesh.quality import degrees
from equimesh.quality.cells import BilinearCells, UniformCells
from equimesh.quality.degrees import degree_errors, gains_by_degree, squared_errors_of_cells
from equimesh.quality.elements import CellKind
from equimesh.quality.measures import measure_errors
from equimesh.solving.solution import Solution
from equimesh_schema import DegreeGain
from solver.quality.handmade import folded, triangle_errors, uniform, wavy

SMOOTH = em.Expression("sin(5*x)*cos(4*y)")
LOBATTO = {1: [0.0, 1.0], 2: [0.0, 0.5, 1.0], 3: [0.0, 0.5 - math.sqrt(0.05), 0.5 + math.sqrt(0.05), 1.0]}


def gains(mesh: em.Mesh, u: em.Field = SMOOTH, kind: CellKind = "quad") -> tuple[DegreeGain, ...]:
    errors = (measure_errors if kind == "quad" else triangle_errors)(mesh, u)
    return gains_by_degree(BilinearCells(mesh), BilinearCells(uniform(*mesh.x.shape)), u, errors, kind)


def plain(mesh: em.Mesh, degree: int, points: int = 12) -> tuple[float, float]:
    """The errors of the interpolant of a degree in L2 and H1, by midpoints, one cell at a time."""
    middles, squares = (np.arange(points) + 0.5) / points, np.zeros(2)
    nodes = np.array(LOBATTO[degree])
    fits = [np.polyfit(nodes, row, degree) for row in np.eye(degree + 1)]
    shape, slope = (
        np.stack([np.polyval(one, middles) for one in some], axis=1) for some in (fits, map(np.polyder, fits))
    )

    def at(q: np.ndarray, s: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.stack([1 - s, s], axis=1) @ q @ np.stack([1 - t, t])

    for i in range(mesh.grid.n_xi - 1):
        for j in range(mesh.grid.n_eta - 1):
            x, y = (q[i : i + 2, j : j + 2] for q in (mesh.x, mesh.y))
            values = SMOOTH.evaluate(at(x, nodes, nodes), at(y, nodes, nodes))[0]
            there, u_x, u_y = SMOOTH.evaluate(at(x, middles, middles), at(y, middles, middles), 1)
            along_s, along_t = np.stack([x[1] - x[0], y[1] - y[0]]), np.stack([x[:, 1] - x[:, 0], y[:, 1] - y[:, 0]])
            x_s, y_s = (row[0] * (1 - middles) + row[1] * middles for row in along_s)
            x_t, y_t = (row[0] * (1 - middles[:, None]) + row[1] * middles[:, None] for row in along_t)
            det = x_s * y_t - x_t * y_s
            v_s, v_t = slope @ values @ shape.T, shape @ values @ slope.T
            error = shape @ values @ shape.T - there
            error_x, error_y = (v_s * y_t - v_t * y_s) / det - u_x, (v_t * x_s - v_s * x_t) / det - u_y
            squares += np.sum(det * error**2), np.sum(det * (error_x**2 + error_y**2))
    return tuple(np.sqrt(squares / points**2))


def test_they_are_the_ratios_of_errors_by_many_points() -> None:
    mesh = wavy(12, 9)
    for found, degree in zip(gains(mesh), (1, 2, 3), strict=True):
        before, after = plain(uniform(12, 9), degree), plain(mesh, degree)
        assert found.degree == degree
        assert found.l2 == pytest.approx(before[0] / after[0], rel=0.03)
        assert found.h1 == pytest.approx(before[1] / after[1], rel=0.03)
    assert gains(mesh)[1].l2 < 0.9 < gains(mesh)[0].l2 + 0.5


def test_they_are_one_on_the_uniform_mesh_and_where_the_elements_are_exact() -> None:
    assert {(one.l2, one.h1) for one in gains(uniform(20, 40))} == {(1.0, 1.0)}
    quadratic = em.Expression("x**2 - 3*x*y + 2*y**2 + 1")
    assert {(one.l2, one.h1) for one in gains(wavy(33, 33), quadratic)[1:]} == {(1.0, 1.0)}
    (_, of_triangles) = gains(wavy(17, 17), quadratic, "triangle")
    assert (of_triangles.l2, of_triangles.h1) == (1.0, 1.0)


def test_on_triangles_the_error_of_degree_2_is_that_of_finer_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    lean = gains(wavy(17, 17), kind="triangle")[1]
    assert 0.1 < lean.l2 < 1.0
    # the centres of 256 equal parts of each triangle
    upright = [(i + 1 / 3, j + 1 / 3) for i in range(16) for j in range(16 - i)]
    s, t = np.array(upright + [(i + 2 / 3, j + 2 / 3) for i in range(16) for j in range(15 - i)]).T / 16
    element = degrees.rule("triangle", 4)
    many = element._replace(
        shape=np.stack([1 - s - t, s, t], axis=1),
        along_s=np.tile(element.along_s[:1], (256, 1)),
        along_t=np.tile(element.along_t[:1], (256, 1)),
        weights=np.full(256, 0.5 / 256),
    )
    monkeypatch.setattr(degrees, "rule", lambda *_: many)
    exact = gains(wavy(17, 17), kind="triangle")[1]
    assert (lean.l2, lean.h1) == pytest.approx((exact.l2, exact.h1), rel=0.03)


def test_scattered_cells_give_nearly_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    some = gains(wavy(65, 65))[1:]
    monkeypatch.setattr(degrees, "MEASURED_CELLS", 10**6)
    for one, exact in zip(some, gains(wavy(65, 65))[1:], strict=True):
        assert one != exact
        assert (one.l2, one.h1) == pytest.approx((exact.l2, exact.h1), rel=0.05)


def test_gains_are_not_known_where_a_layer_lies_inside_a_cell() -> None:
    mesh = wavy(17, 17)
    errors = replace(measure_errors(mesh, SMOOTH), resolved=(True, False))
    found = gains_by_degree(BilinearCells(mesh), BilinearCells(uniform(17, 17)), SMOOTH, errors)
    assert [(one.l2 > 0.0, math.isnan(one.h1)) for one in found] == [(True, True)] * 3


def test_few_points_are_evaluated() -> None:
    points = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            points.append(x.size)
            return SMOOTH.evaluate(x, y, order)

    mesh = wavy(129, 129)
    errors = measure_errors(mesh, SMOOTH)
    plainly = UniformCells(mesh.grid, em.Rectangle())
    gains_by_degree(BilinearCells(mesh), plainly, Counting(), errors)  # type: ignore[arg-type]
    assert sum(points) <= 2 * (16 + 9 + 16) * 391


# The errors of the interpolant of one degree on a whole mesh.


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_errors_of_a_degree_are_those_by_many_points(degree: int) -> None:
    mesh = wavy(12, 9)
    errors = degree_errors(BilinearCells(mesh), BilinearCells(uniform(12, 9)), SMOOTH, degree)
    assert (errors.l2, errors.h1) == pytest.approx(plain(mesh, degree, 24), rel=0.015)
    assert (errors.l2_uniform, errors.h1_uniform) == pytest.approx(plain(uniform(12, 9), degree, 24), rel=0.015)
    assert errors.degree == degree
    assert errors.resolved == (True, True)


@pytest.mark.parametrize("kind", ["quad", "triangle"])
def test_degree_1_has_the_errors_that_are_measured_without_a_degree(kind: CellKind) -> None:
    mesh = wavy(17, 14)
    measured = (measure_errors if kind == "quad" else triangle_errors)(mesh, SMOOTH)
    errors = degree_errors(BilinearCells(mesh), BilinearCells(uniform(17, 14)), SMOOTH, 1, kind)
    for name in ("l2", "h1", "l2_uniform", "h1_uniform"):
        assert getattr(errors, name) == pytest.approx(getattr(measured, name), rel=2e-3), name
    assert errors.variation == pytest.approx(measured.variation, rel=1e-2)
    assert 0.5 < errors.largest.value / measured.largest.value < 2.0  # at other points


@pytest.mark.parametrize("kind", ["quad", "triangle"])
def test_parts_of_cells_are_measured_where_a_layer_lies_inside_one(kind: CellKind) -> None:
    # A front of a thousandth of the domain on 8 x 8 cells: the two rules differ, and parts take their place.
    front, mesh = em.Expression("tanh(1000*(x - 0.41))"), uniform(9, 9)
    errors = degree_errors(BilinearCells(mesh), None, front, 2, kind)
    # On the one column of cells with the front, the interpolant is that of a jump at 0.41 there.
    nodes, points = np.array([0.375, 0.4375, 0.5]), 0.375 + 0.125 * (np.arange(4000) + 0.5) / 4000
    there = np.polyval(np.polyfit(nodes, np.tanh(1000 * (nodes - 0.41)), 2), points)
    expected = math.sqrt(0.125 * np.mean((there - np.tanh(1000 * (points - 0.41))) ** 2))
    if kind == "quad":
        assert errors.l2 == pytest.approx(expected, rel=0.02)
    else:
        assert 0.5 * expected < errors.l2 < 2.0 * expected
    assert errors.resolved[0]
    assert math.isnan(errors.l2_uniform)
    jump = degree_errors(BilinearCells(mesh), None, em.Expression("where(x < 0.41, 0, 1)"), 2, kind)
    assert not jump.resolved[1]  # no point of a rule sees its gradient, and the rim of the cell does


def test_errors_of_cells_add_up() -> None:
    cells = BilinearCells(wavy(12, 9))
    squares = squared_errors_of_cells(cells, SMOOTH, 3)
    assert squares.shape == (cells.count,)
    assert math.sqrt(squares.sum()) == pytest.approx(degree_errors(cells, None, SMOOTH, 3).l2, rel=1e-12)


def test_a_folded_mesh_has_infinite_errors() -> None:
    errors = degree_errors(BilinearCells(folded()), None, SMOOTH, 2)
    assert math.isinf(errors.l2)
    assert math.isinf(errors.h1)


# Linear interpolation on triangles: against plain sums over the triangles of the mesh file.

SECTOR = em.AnnulusSector(center=(0.3, -0.4), radii=(0.6, 1.4), angles=(10.0, 100.0))
WAVE = em.Expression("tanh(8*(x - 0.4*y)) + x*y")


def bent(n_xi: int, n_eta: int, seed: int = 1, share: float = 0.3) -> em.Mesh:
    """A valid mesh of the unit square with uneven cells, of which some are cut along each diagonal."""
    uniform = em.Mesh.uniform(em.Grid(n_xi=n_xi, n_eta=n_eta))
    moves = np.random.default_rng(seed).uniform(-share, share, (2, n_xi, n_eta)) / max(n_xi, n_eta)
    return em.Mesh.of_unit_square(uniform.x + moves[0], uniform.y + moves[1])


def plain_on_triangles(mesh: em.Mesh, u: em.Field, parts: int = 4) -> tuple[float, float]:
    """The two norms, by the middles of ``parts**2`` equal parts of every triangle."""
    cells = np.zeros((mesh.grid.n_xi - 1, mesh.grid.n_eta - 1))
    rows = MeshData(mesh=mesh, u=None, q_eq=cells, subdomain=cells.astype(np.int64)).triangles()
    corners, nodal = mesh.points[rows], u.evaluate(*mesh.points.T)[0][rows]
    edges = corners[:, 1:] - corners[:, :1]
    area = 0.5 * np.linalg.det(edges)
    slope = np.linalg.solve(edges, (nodal[:, 1:] - nodal[:, :1])[..., None])[..., 0]
    upward = [(i + 1 / 3, j + 1 / 3) for i in range(parts) for j in range(parts - i)]
    downward = [(i + 2 / 3, j + 2 / 3) for i in range(parts) for j in range(parts - i - 1)]
    sums = np.zeros(2)
    for s, t in np.array(upward + downward) / parts:
        at = corners[:, 0] + s * edges[:, 0] + t * edges[:, 1]
        there, u_x, u_y = u.evaluate(*at.T, order=1)
        error = nodal @ [1 - s - t, s, t] - there
        sums += np.array([area @ error**2, area @ ((slope[:, 0] - u_x) ** 2 + (slope[:, 1] - u_y) ** 2)]) / parts**2
    return math.sqrt(sums[0]), math.sqrt(sums[1])


@pytest.mark.parametrize("domain", [em.Rectangle(), SECTOR], ids=["square", "sector"])
def test_the_errors_are_those_of_plain_sums(domain: em.Domain) -> None:
    mesh, uniform = map_mesh(bent(8, 7), domain), map_mesh(em.Mesh.uniform(em.Grid(n_xi=8, n_eta=7)), domain)
    errors = triangle_errors(mesh, WAVE, uniform)
    assert (errors.l2, errors.h1) == pytest.approx(plain_on_triangles(mesh, WAVE, 16), rel=1e-2)
    assert (errors.l2_uniform, errors.h1_uniform) == pytest.approx(plain_on_triangles(uniform, WAVE, 16), rel=1e-2)
    assert errors.resolved == (True, True)


def test_a_quadratic_is_measured_exactly() -> None:
    # On right triangles of width h the error of x^2 is x (h - x) along x alone: h^4 / 30 a unit of area.
    uniform = em.Mesh.uniform(em.Grid(n_xi=9, n_eta=5))
    errors = triangle_errors(uniform, em.Expression("x**2"))
    assert errors.l2 == pytest.approx((1 / 8) ** 2 / math.sqrt(30), rel=1e-12)
    assert errors.h1 == pytest.approx((1 / 8) / math.sqrt(3), rel=1e-12)
    assert (errors.gain_l2, errors.gain_h1) == (1.0, 1.0)
    assert errors.variation == 1.0
    assert errors.largest.value == pytest.approx((1 / 16) ** 2, rel=0.05)


def test_a_linear_u_has_no_error_and_a_bilinear_one_has() -> None:
    mesh = bent(9, 9)
    assert triangle_errors(mesh, em.Expression("2*x - 3*y")).gain_l2 == 1.0
    assert triangle_errors(mesh, em.Expression("2*x - 3*y")).l2 < 1e-14
    bilinear = em.Expression("x*y")
    assert triangle_errors(em.Mesh.uniform(mesh.grid), bilinear).l2 > 1e-3
    assert measure_errors(em.Mesh.uniform(mesh.grid), bilinear).l2 < 1e-14


def test_a_layer_inside_triangles_is_refined_or_not_resolved() -> None:
    uniform = em.Mesh.uniform(em.Grid(n_xi=17, n_eta=17))
    steep = triangle_errors(uniform, em.Expression("tanh(200*(x + y - 0.83))"))
    assert steep.resolved[0]
    by_plain_sums = plain_on_triangles(uniform, em.Expression("tanh(200*(x + y - 0.83))"), 24)
    assert (steep.l2, steep.h1) == pytest.approx(by_plain_sums, rel=0.05)  # to which a norm is resolved
    assert not triangle_errors(uniform, em.Expression("where(x + y < 0.83, 0, 1)")).resolved[1]


def test_a_sample_stands_for_all_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = bent(90, 80)
    whole = triangle_errors(mesh, WAVE)
    monkeypatch.setattr(degrees, "sample", lambda rows: np.arange(0, rows.own.stop, 7))
    part = triangle_errors(mesh, WAVE)
    assert part.l2 != whole.l2
    assert (part.l2, part.h1) == pytest.approx((whole.l2, whole.h1), rel=0.02)


@pytest.mark.parametrize("norm", ["l2", "h1"])
def test_a_solution_on_triangles_is_measured_on_triangles(norm: str) -> None:
    grid = em.Grid(n_xi=25, n_eta=21)
    u = em.Expression("exp(-50*((x - 0.5)**2 + (y - 0.5)**2))")  # its descents end alike on every processor

    def solved(kind: str) -> Solution:
        monitor = em.LeastError(u=u, norm=norm, cells=kind)  # type: ignore[arg-type]
        return em.solve(em.Problem(monitor=monitor, grid=grid), threads=1)

    on_triangles, on_cells = solved("triangle"), solved("quad")
    errors, others = on_triangles.interpolation, triangle_errors(on_cells.mesh, u)
    assert errors == triangle_errors(on_triangles.mesh, u)
    assert min(errors.gain_l2, errors.gain_h1) >= 1.0
    assert on_triangles.descent[-1]["gain"] == pytest.approx(errors.estimated_gain(norm), rel=0.25)
    assert getattr(errors, norm) < 0.9 * getattr(others, norm)
