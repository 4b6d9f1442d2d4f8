"""The discrete equations of a window: what solves them, and which conditions own which rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import equimesh as em
from cases import problem
from equimesh.equations.mesh_equations import HalfFlux, LocalMetric, MeshEquations, NodalState, Rows, SeenGradient
from equimesh.equations.metric import ReferenceMetric, Vector
from equimesh.equations.problem import sides


@dataclass(frozen=True)
class Held:
    """The x of one node, held at a value."""

    node: tuple[int, int]
    value: float

    def rows(self, window: NodalState) -> Rows:
        unknown = np.array([window.numbers[0][self.node]])
        return Rows(unknown, np.array([window.x[self.node] - self.value]), lambda: [(unknown, unknown, np.ones(1))])


@pytest.mark.parametrize("boundary", em.Boundary)
@pytest.mark.parametrize("cross_line", [0.0, 0.7])
def test_the_uniform_mesh_solves_the_equations_of_no_monitor(boundary: em.Boundary, cross_line: float) -> None:
    case = problem("ring", 9, 6, boundary=boundary, a=0.0)
    equations = case.equations(cross_line)
    z = equations.vector(em.Mesh.uniform(case.grid))
    assert abs(equations.residual(z)).max() < 1e-13
    assert equations.mean_flux(z) == pytest.approx(1.0)


def test_a_vector_is_x_and_then_y() -> None:
    case = problem("ring", 5, 4)
    mesh = em.solve(case).reference
    z = case.equations().vector(mesh)
    assert z.tolist() == [*mesh.x.ravel(), *mesh.y.ravel()]
    again = case.equations().mesh(z)
    assert np.array_equal(again.x, mesh.x)
    assert np.array_equal(again.y, mesh.y)
    again.x[:] = 7.0
    assert not (z == 7.0).any(), "a mesh owns its nodes"


def test_a_turned_window_turned_again_is_the_window() -> None:
    case = problem("ring", 6, 5, b=0.2)
    equations = case.equations()
    window = equations.window(equations.vector(em.Mesh.uniform(case.grid)))
    turned = window.turned()
    assert turned.x.shape == (5, 6)
    assert np.array_equal(turned.u_x, window.u_y.T)
    again = turned.turned()
    for name in ("x", "y", "u", "u_x", "u_y"):
        assert np.array_equal(getattr(again, name), getattr(window, name)), name
    assert (again.d_xi, again.d_eta, again.metric) == (window.d_xi, window.d_eta, window.metric)


def test_a_condition_takes_the_place_of_those_before_it() -> None:
    case = problem("ring", 6, 5)
    first, second = Held((2, 2), 5.0), Held((2, 2), 7.0)
    closed = [*sides(case.boundary).values(), first, second]
    equations = MeshEquations(case.metric, case.grid.shape, (case.grid.d_xi, case.grid.d_eta), closed)
    z = equations.vector(em.Mesh.uniform(case.grid))
    row = equations.numbers[0][2, 2]
    assert equations.residual(z)[row] == z[row] - 7.0
    derivative = equations.jacobian(z).tocsr()[[row]].toarray().ravel()
    assert np.flatnonzero(derivative).tolist() == [row], "nothing of the interior is left in the row"
    assert derivative[row] == 1.0


def test_an_edge_s_flux_goes_to_its_two_ends_with_opposite_signs() -> None:
    """Summed along a line the interior equations telescope: only the outermost edges are left."""
    case = problem("ring", 8, 5, b=0.1)
    equations = MeshEquations(case.metric, case.grid.shape, (case.grid.d_xi, case.grid.d_eta), [])
    uniform = em.Mesh.uniform(case.grid)
    z = equations.vector(em.Mesh(uniform.x + 0.02 * np.sin(5 * uniform.y), uniform.y + 0.03 * uniform.x**2))
    whole = equations.residual(z)[: equations.size].reshape(case.grid.shape)[1:-1, 1:-1].sum(axis=0)
    parts = []
    for rows in (slice(0, 3), slice(5, 8)):
        mesh = em.Mesh(equations.mesh(z).x[rows], equations.mesh(z).y[rows])
        part = MeshEquations(case.metric, (3, 5), (case.grid.d_xi, case.grid.d_eta), [])
        parts.append(part.residual(part.vector(mesh))[:15].reshape(3, 5)[1, 1:-1])
    middle = em.Mesh(equations.mesh(z).x[1:7], equations.mesh(z).y[1:7])
    inner = MeshEquations(case.metric, (6, 5), (case.grid.d_xi, case.grid.d_eta), [])
    inside = inner.residual(inner.vector(middle))[:30].reshape(6, 5)[1:-1, 1:-1].sum(axis=0)
    assert whole == pytest.approx(parts[0] + inside + parts[1])


# Metric lengths of directions, and their derivatives, against difference quotients.


STEP = 1e-6
ARC_LENGTH = em.ArcLength(u=em.Expression("sin(3*x)*y"), a=0.8, b=0.3)
WEIGHT = em.Weight(rho=em.Expression("1 + x**2 + 2*y"))
SECTOR = em.AnnulusSector(angles=(0, 100))

each_metric = pytest.mark.parametrize(
    "metric",
    [ReferenceMetric(m, d) for m in (ARC_LENGTH, WEIGHT) for d in (em.Rectangle(), SECTOR)],
    ids=["arc length", "arc length on a sector", "weight", "weight on a sector"],
)


def pair(first: float, second: float) -> Vector:
    return np.array([first]), np.array([second])


def half_flux(metric: ReferenceMetric, d: Vector, g: Vector, point: Vector) -> HalfFlux:
    return HalfFlux(d, LocalMetric(metric, point, g))


def slopes(metric: ReferenceMetric, varied: str) -> list[float]:
    """The difference quotients of the flux by the two components of one of its arguments."""
    given = {"d": pair(0.7, -0.4), "g": pair(1.1, 0.6), "point": pair(0.3, 0.8)}
    found = []
    for component in (0, 1):
        values = []
        for h in (STEP, -STEP):
            moved = [q.copy() for q in given[varied]]
            moved[component] += h
            values.append(half_flux(metric, **(given | {varied: (moved[0], moved[1])})).value[0])
        found.append((values[0] - values[1]) / (2 * STEP))
    return found


@each_metric
def test_the_derivatives_of_a_flux(metric: ReferenceMetric) -> None:
    flux = half_flux(metric, pair(0.7, -0.4), pair(1.1, 0.6), pair(0.3, 0.8))
    assert np.ravel(flux.by_direction) == pytest.approx(slopes(metric, "d"), abs=1e-7)
    assert np.ravel(flux.by_gradient) == pytest.approx(slopes(metric, "g"), abs=1e-7)
    by_position = [0.0, 0.0] if flux.by_position is None else np.ravel(flux.by_position)
    assert by_position == pytest.approx(slopes(metric, "point"), abs=1e-6)


@each_metric
def test_the_metric_length_is_a_square_of_the_direction(metric: ReferenceMetric) -> None:
    one = half_flux(metric, pair(0.7, -0.4), pair(1.1, 0.6), pair(0.3, 0.8)).value
    two = half_flux(metric, pair(-1.4, 0.8), pair(1.1, 0.6), pair(0.3, 0.8)).value
    assert one > 0
    assert two == pytest.approx(4 * one)


def test_the_gradient_of_a_linear_function_is_seen_exactly() -> None:
    """u = 2x - 3y, seen through any map x(xi, eta), y(xi, eta)."""
    x_xi, y_xi, x_eta, y_eta = np.random.default_rng(4).uniform(0.5, 1.0, (4, 6)) * [[1], [0.2], [-0.3], [1]]
    seen = SeenGradient(x_xi, y_xi, x_eta, y_eta, 2 * x_xi - 3 * y_xi, 2 * x_eta - 3 * y_eta)
    assert (seen.jacobian > 0).all()
    assert np.array(seen.gradient) == pytest.approx(np.array([[2.0] * 6, [-3.0] * 6]))
