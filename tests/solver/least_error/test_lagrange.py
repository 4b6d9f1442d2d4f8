"""The loops for elements of higher degree: those of degree 1 as a special case, exactness, and infinite slopes."""

from __future__ import annotations

import math

import numpy as np
import pytest

import equimesh as em
from equimesh.least_error import kernels, lagrange
from equimesh.least_error import objective as module
from equimesh.least_error.kernels import SUMS, NodalValues, Nodes, Norm, Rule, Values
from equimesh.quality.elements import CellKind, basis
from solver.bent import RING, bent, objective_on, remainders, uniform

GRID = em.Grid(n_xi=6, n_eta=5)


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
    assert here is not None
    assert np.isfinite(here.gradient).all()
    assert np.isfinite(here.blocks).all()
    along = np.zeros_like(mesh)
    inner = (mesh[0] > 0.3) & (mesh[0] < 0.9) & (mesh[1] > 0.0) & (mesh[1] < 1.0)
    along[:, inner] = np.random.default_rng(4).normal(size=(2, int(inner.sum())))

    def value(h: float) -> float:
        then = objective.evaluate(mesh + h * along)
        assert then is not None
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
