"""Gains of elements of each degree: against errors by many points, and on meshes where they are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import equimesh as em
from equimesh.quality import degrees
from equimesh.quality.cells import BilinearCells, UniformCells
from equimesh.quality.degrees import degree_errors, gains_by_degree, squared_errors_of_cells
from equimesh.quality.elements import CellKind
from equimesh.quality.interpolation import interpolation_errors
from equimesh.quality.triangles import triangle_errors
from equimesh_schema import DegreeGain
from solver.quality.handmade import folded, uniform, wavy

SMOOTH = em.Expression("sin(5*x)*cos(4*y)")
LOBATTO = {1: [0.0, 1.0], 2: [0.0, 0.5, 1.0], 3: [0.0, 0.5 - math.sqrt(0.05), 0.5 + math.sqrt(0.05), 1.0]}


def gains(mesh: em.Mesh, u: em.Field = SMOOTH, kind: CellKind = "quad") -> tuple[DegreeGain, ...]:
    errors = (interpolation_errors if kind == "quad" else triangle_errors)(mesh, u)
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
    errors = replace(interpolation_errors(mesh, SMOOTH), resolved=(True, False))
    found = gains_by_degree(BilinearCells(mesh), BilinearCells(uniform(17, 17)), SMOOTH, errors)
    assert [(one.l2 > 0.0, math.isnan(one.h1)) for one in found] == [(True, True)] * 3


def test_few_points_are_evaluated() -> None:
    points = []

    class Counting:
        def evaluate(self, x: np.ndarray, y: np.ndarray, order: int = 0) -> tuple[np.ndarray, ...]:
            points.append(x.size)
            return SMOOTH.evaluate(x, y, order)

    mesh = wavy(129, 129)
    errors = interpolation_errors(mesh, SMOOTH)
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
    measured = (interpolation_errors if kind == "quad" else triangle_errors)(mesh, SMOOTH)
    errors = degree_errors(BilinearCells(mesh), BilinearCells(uniform(17, 14)), SMOOTH, 1, kind)
    for name in ("l2", "h1", "l2_uniform", "h1_uniform"):
        assert getattr(errors, name) == pytest.approx(getattr(measured, name), rel=2e-3), name
    assert errors.variation == pytest.approx(measured.variation, rel=1e-2)
    assert errors.largest is not None
    assert measured.largest is not None
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


def test_errors_of_cells_add_up() -> None:
    cells = BilinearCells(wavy(12, 9))
    squares = squared_errors_of_cells(cells, SMOOTH, 3)
    assert squares.shape == (cells.count,)
    assert math.sqrt(squares.sum()) == pytest.approx(degree_errors(cells, None, SMOOTH, 3).l2, rel=1e-12)


def test_a_folded_mesh_has_infinite_errors() -> None:
    errors = degree_errors(BilinearCells(folded()), None, SMOOTH, 2)
    assert math.isinf(errors.l2)
    assert math.isinf(errors.h1)
